"""The input of an export: a labelled sequence, its label files and its recording.

**Conventions.** Grids have the shape of the labels' grid and are aligned with the ego frame at the frame's stamp
(CONVENTIONS.md). Values are immutable and loaded on first use, so an export needs the memory of one frame.
"""

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.dataset_source import DatasetSourceFiles
from services.labeler.exports.errors import damaged_labels
from stone.errors import Refused
from stone.sensors.samples import SampleSource
from stone.sensors.sequence import Sequence
from stone_base.label_grid import LabelGrid, recorded_grid
from stone_recordings.sync.sequence_file import read_sequence

REPORT, SEQUENCE, SOURCE, MESH, TABLE = "report.json", "sequence.npz", "source.json", "mesh.ply", "frames.parquet"
MOST_JSON_BYTES = 1 << 28
OpenSamples = Callable[[Path, Sequence], SampleSource]


@dataclass(frozen=True, eq=False)
class LabelledSequence:
    """`labels(index)` returns a frame's `labels.npz`; `mesh` is the map's PLY, `frames_table` the Parquet.

    `published` are the published files of imported labels, None for labels made by STONE.
    """

    sequence: Sequence
    samples: SampleSource
    labels: Callable[[int], bytes]
    report: Mapping[str, Any]
    mesh: Path
    frames_table: Path
    published: DatasetSourceFiles | None = None

    @cached_property
    def grid(self) -> LabelGrid:
        """The grid of its labels, from its report. Raises `bad_grid`."""
        return recorded_grid(self.report.get("grid"))

    def grids(self, index: int) -> dict[str, NDArray[Any]]:
        """Return the grids of frame `index`: semantics, mask_lidar and mask_camera, uint8, and further ones.

        Raises `damaged_labels`.
        """
        payload = self.labels(index)
        try:
            with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
                grids = dict(arrays)
                _check_grids(grids, self.grid.shape)
                return grids
        except (ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile) as error:
            token = self.sequence.frames.tokens[index]
            raise damaged_labels(Path(token) / "labels.npz", str(error)) from error


@dataclass(frozen=True)
class _FrameFiles:
    """The labels of frames as files of a folder; a value that can be passed to workers."""

    folder: Path
    tokens: tuple[str, ...]

    def __call__(self, index: int) -> bytes:
        path = self.folder / self.tokens[index] / "labels.npz"
        try:
            return path.read_bytes()
        except FileNotFoundError as error:
            raise damaged_labels(path, "it is missing") from error


def _check_grids(grids: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> None:
    for key in ("semantics", "mask_lidar", "mask_camera"):
        if grids[key].shape != shape or grids[key].dtype != np.uint8:
            raise ValueError(f"{key} is {grids[key].dtype} {grids[key].shape}")


def folder_source(directory: Path, open_samples: OpenSamples, bag: Path | None = None) -> LabelledSequence:
    """Return the sequence in a folder of `stone label`; the recording is at its original path, or at `bag`.

    `open_samples` opens the recording at a path for a sequence (`stone_recordings.sync.samples.checked_samples`).
    Raises `not_labels`, `damaged_labels`, `recording_gone`, and what `open_samples` raises.
    """
    report, sequence = read_report(directory), _sequence(directory)
    recording = bag or recorded_at(directory)
    if recording is None or not recording.exists():
        raise recording_gone(recording)
    return LabelledSequence(
        sequence,
        open_samples(recording, sequence),
        _FrameFiles(directory / "gts" / sequence.name, sequence.frames.tokens),
        report,
        directory / MESH,
        directory / TABLE,
    )


def read_report(directory: Path) -> Mapping[str, Any]:
    """Return the report of the labels in a folder. Raises `not_labels`, `damaged_labels`."""
    for name in (REPORT, SEQUENCE, TABLE, "gts"):
        if not (directory / name).exists():
            raise Refused(
                "not_labels",
                f"{directory} has no {name}, so it is not an output folder of this version of `stone label`; give the "
                "folder that was passed as --output, or label the recording again",
            )
    return _json(directory / REPORT)


def recorded_at(directory: Path) -> Path | None:
    """Return the path of the labelled recording, or None if it is not recorded. Raises `damaged_labels`."""
    if not (directory / SOURCE).exists():
        return None
    recording = _json(directory / SOURCE).get("recording")
    return Path(recording) if isinstance(recording, str) else None


def _sequence(directory: Path) -> Sequence:
    path = directory / SEQUENCE
    try:
        return read_sequence(path.read_bytes())
    except (ValueError, OSError, KeyError, EOFError, TypeError, zipfile.BadZipFile) as error:
        raise damaged_labels(path, str(error)) from error


def _json(path: Path) -> Mapping[str, Any]:
    try:
        if path.stat().st_size > MOST_JSON_BYTES:
            raise damaged_labels(path, f"it has more than {MOST_JSON_BYTES} bytes")
        content = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError) as error:
        raise damaged_labels(path, str(error)) from error
    if not isinstance(content, dict):
        raise damaged_labels(path, "it is not a JSON object")
    return content


def recording_gone(path: Path | None) -> Refused:
    where = (
        f"the recording {path} does not exist any more"
        if path
        else "the labels do not contain the path of their recording"
    )
    return Refused("recording_gone", f"{where}; give its current path with --bag")
