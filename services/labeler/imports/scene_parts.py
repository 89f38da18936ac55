"""The files of a scene from the index of a dataset, for its import.

    scenes/<ordinal>/sequence.npz   the synchronised sequence
    scenes/<ordinal>/files.npz      spans of its files and labels in the archive
    scenes/<ordinal>/about.json     `SceneAbout`
    scenes/<ordinal>/tables/…       its tables and splits

**Conventions.** Spans outside the tar or zip are refused when they are read.
"""

import io
import json
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.exports.dataset_source import joined_names, parted_names
from stone.errors import Refused
from stone.sensors.sequence import Sequence
from stone_base.label_grid import grid_of
from stone_datasets.classes import ClassMap
from stone_datasets.index import label_name
from stone_datasets.scene_spans import SceneSpans
from stone_datasets.stated_layout import UNSTATED, StatedLayout
from stone_datasets.zip_files import PLACE, placed_span
from stone_exports.files import ExportFileSpan
from stone_files.byte_ranges import ByteRanges, LocalRanges
from stone_files.dataset_layouts import DatasetLayout, named_layout
from stone_files.npz import npz_bytes
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes

FILES, ABOUT, TABLES = "files.npz", "about.json", "tables"


@dataclass(frozen=True)
class SceneAbout:
    """Facts that a scene shares with its dataset.

    - `version`: the folder of tables, "" if there is none
    - `root`: the folder in the archive
    - `layout`: a name of `LAYOUTS`
    - `grid`: the record of its labels' grid
    - `has_dashes`: the dataset writes tokens as UUIDs
    """

    version: str
    root: str
    layout: str
    grid: dict[str, object]
    has_dashes: bool

    def labels_as(self) -> DatasetLayout:
        """Return the layout of its label files. Raises `bad_layout`, `bad_grid`."""
        return named_layout(self.layout).with_grid(grid_of(self.grid))


@dataclass(frozen=True, eq=False)
class SceneParts:
    """The scene in the folder `folder`, whose files are in the archive."""

    folder: Path
    archive: ByteRanges
    about: SceneAbout
    layout: DatasetLayout
    sequence: Sequence
    spans: SceneSpans

    def file(self, number: int) -> ExportFileSpan:
        """Return the file with this index in `spans.names`."""
        names = (self.spans.names[number], self.spans.held[number])
        return placed_span(self.archive, names, self.spans.places[number])

    def label_file(self, frame: int) -> ExportFileSpan:
        """Return the labels of this frame under the dataset's name."""
        token, has_dashes = self.sequence.frames.tokens[frame], self.about.has_dashes
        name = label_name(self.sequence.name, token, has_dashes=has_dashes)
        return placed_span(self.archive, (name, f"{self.about.root}{name}"), self.spans.labels[frame])


def write_scene_parts(folder: Path, about: SceneAbout, sequence: Sequence, spans: SceneSpans) -> None:
    """Write everything except the tables into the folder, which exists."""
    (folder / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    (folder / ABOUT).write_text(json.dumps(asdict(about)))
    numbers = {"places": spans.places, "rows": spans.rows, "labels": spans.labels}
    names = {key: joined_names(getattr(spans, key)) for key in ("names", "held", "channels")}
    (folder / FILES).write_bytes(npz_bytes({**numbers, **names}))


def read_scene_parts(folder: Path, archive: Path | ByteRanges) -> SceneParts:
    """Return the scene's parts. Raises `scene_damaged`."""
    try:
        sequence = read_sequence((folder / SEQUENCE_FILE).read_bytes())
        about = SceneAbout(**json.loads((folder / ABOUT).read_bytes()))
        layout = about.labels_as()
        with np.load(io.BytesIO((folder / FILES).read_bytes()), allow_pickle=False) as arrays:
            numbers = [arrays[key].astype(np.int64) for key in ("places", "rows", "labels")]
            names, held, channels = (parted_names(arrays[key]) for key in ("names", "held", "channels"))
    except (Refused, OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise scene_damaged(f"{folder.name} cannot be read ({error})") from error
    places, rows, labels = numbers
    spans = SceneSpans(names, held, places, channels, rows, labels)
    ranges = LocalRanges(archive) if isinstance(archive, Path) else archive
    parts = SceneParts(folder, ranges, about, layout, sequence, spans)
    _check(parts)
    return parts


def _check(parts: SceneParts) -> None:
    spans, size_bytes = parts.spans, parts.archive.size_bytes
    counts = {len(spans.names), len(spans.held), len(spans.channels), len(spans.places), len(spans.rows)}
    wanted = (len(parts.sequence.frames), len(PLACE))
    if len(counts) > 1 or spans.places.shape[1:] != wanted[1:] or spans.labels.shape != wanted:
        raise scene_damaged(f"{parts.folder.name} has fewer or more spans than files, or than labels and frames")
    for offset, size, packed, limit, *_ in np.concatenate([spans.places, spans.labels]).tolist():
        stop = offset + size if packed < 0 else limit
        if offset < 0 or size < 0 or not offset <= stop <= size_bytes:
            raise scene_damaged(f"a span of {size} bytes from {offset} exceeds the {size_bytes} bytes of the archive")


# Inputs of the sandboxed children of an import: the archive of a dataset, and the requested result, as values that can
# be pickled. A child works in the folder `dataset` of the run's workspace. The indexing child writes a scene's tables
# and file offsets to `scenes/<ordinal in six digits>/`. The importing child reads them there and writes its artefacts
# by name to the folder `out` beside them.


SCENES, OUT, EXTRA = "scenes", "out", "extra"


@dataclass(frozen=True)
class DatasetOpening:
    """A whole dataset: its archive, its owner's name for it, the archive's sha256, its classes and stated layout."""

    dataset: Path | ByteRanges
    name: str
    sha256: str
    classes: ClassMap
    stated: StatedLayout = UNSTATED


@dataclass(frozen=True)
class SceneOpening:
    """One scene of an indexed dataset: as `DatasetOpening`, and the scene's index in the dataset.

    If the archive is read in place (`is_in_place`), sensor files are not read, and no file is copied.
    """

    dataset: Path | ByteRanges
    ordinal: int
    classes: ClassMap
    is_in_place: bool = False


def scene_folder(ordinal: int) -> PurePosixPath:
    """Return the path of a scene's files relative to the child's folder."""
    return PurePosixPath(SCENES, f"{ordinal:06d}")


def extra_path(folder: Path, number: int) -> Path:
    """Return the path of a file outside the tables, in the folder of the indexing child."""
    return folder / EXTRA / f"{number:06d}"


def scene_damaged(what: str) -> Refused:
    return Refused(
        "scene_damaged", f"{what[:200]}: did the dataset or its index files change? Import the dataset again"
    )
