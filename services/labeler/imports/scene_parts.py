"""What the index of a dataset leaves of a scene for its import.

    scenes/<ordinal>/sequence.npz   the synchronised sequence
    scenes/<ordinal>/files.npz      spans of its files and labels in the tar
    scenes/<ordinal>/about.json     the folder of tables in the dataset, "" where it has none
    scenes/<ordinal>/tables/…       its tables and splits

**Conventions.** Spans lie within the tar, or are refused when they are read.
"""

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from services.domain.sequences.run_files import SEQUENCE_FILE
from stone.errors import Refused
from stone.sensors.sequence import Sequence
from stone_datasets.classes import ClassMap
from stone_datasets.scene_spans import SceneSpans
from stone_files.npz import npz_bytes
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes

FILES, ABOUT, TABLES = "files.npz", "about.json", "tables"


@dataclass(frozen=True, eq=False)
class SceneParts:
    """The scene in the folder `folder`, whose files lie in `tar`."""

    folder: Path
    tar: Path
    version: str
    sequence: Sequence
    spans: SceneSpans


def write_scene_parts(folder: Path, version: str, sequence: Sequence, spans: SceneSpans) -> None:
    """Write all but the tables into the folder, which is there."""
    (folder / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    (folder / ABOUT).write_text(json.dumps({"version": version}))
    numbers = {"places": spans.places, "rows": spans.rows, "labels": spans.labels}
    names = {"names": _joined(spans.names), "channels": _joined(spans.channels)}
    (folder / FILES).write_bytes(npz_bytes({**numbers, **names}))


def read_scene_parts(folder: Path, tar: Path) -> SceneParts:
    """Raises `scene_damaged`."""
    try:
        sequence = read_sequence((folder / SEQUENCE_FILE).read_bytes())
        version = str(json.loads((folder / ABOUT).read_bytes())["version"])
        with np.load(io.BytesIO((folder / FILES).read_bytes()), allow_pickle=False) as arrays:
            numbers = [arrays[key].astype(np.int64) for key in ("places", "rows", "labels")]
            names, channels = (_parted(arrays[key]) for key in ("names", "channels"))
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise scene_damaged(f"{folder.name} cannot be read ({error})") from error
    places, rows, labels = numbers
    parts = SceneParts(folder, tar, version, sequence, SceneSpans(names, places, channels, rows, labels))
    _check(parts)
    return parts


def _check(parts: SceneParts) -> None:
    spans, size_bytes = parts.spans, parts.tar.stat().st_size
    counts = {len(spans.names), len(spans.channels), len(spans.places), len(spans.rows)}
    if len(counts) > 1 or spans.places.shape[1:] != (2,) or spans.labels.shape != (len(parts.sequence.frames), 2):
        raise scene_damaged(f"{parts.folder.name} has not as many spans as files, or as labels as frames")
    for offset, size in np.concatenate([spans.places, spans.labels]).tolist():
        if offset < 0 or size < 0 or offset + size > size_bytes:
            raise scene_damaged(f"a span of {size} bytes from {offset} on leaves the {size_bytes} bytes of the tar")


def _joined(words: tuple[str, ...]) -> NDArray[np.uint8]:
    return np.frombuffer("\n".join((str(len(words)), *words)).encode("ascii"), np.uint8)


def _parted(joined: NDArray[np.uint8]) -> tuple[str, ...]:
    count, *words = joined.tobytes().decode("ascii").split("\n")
    if int(count) != len(words):
        raise ValueError("a list of names is cut off")
    return tuple(words)


# What the sandboxed children of an import are given: the tar of a dataset, and what is to be made of it.
#
# **Conventions.** Values that can be pickled. A child works in the folder `dataset` of the run's workspace: the one
# that indexes leaves the tables of a scene, and where its files lie in the tar, in `scenes/<ordinal in six digits>/`;
# the one that imports that scene reads them there and leaves its artefacts, by their names, in the folder `out`
# beside.


SCENES, OUT = "scenes", "out"


@dataclass(frozen=True)
class DatasetOpening:
    """A whole dataset: its tar, what its owner calls it, the tar's sha256, and what the numbers of its labels mean."""

    dataset: Path
    name: str
    sha256: str
    classes: ClassMap


@dataclass(frozen=True)
class SceneOpening:
    """One scene of a dataset that was indexed: as `DatasetOpening`, and the scene's place in the dataset."""

    dataset: Path
    ordinal: int
    name: str
    sha256: str
    classes: ClassMap


def scene_folder(ordinal: int) -> PurePosixPath:
    """Where the files of a scene lie below the child's folder."""
    return PurePosixPath(SCENES, f"{ordinal:06d}")


# What is refused of what an index left of a scene.


def scene_damaged(what: str) -> Refused:
    return Refused("scene_damaged", f"{what[:200]}: was the dataset, or what its index left, changed? import it again")
