"""Which frames to train on, watch and predict: those of exports, with labels of theirs or of a dataset version.

**Conventions.** Sources are as `stone baseline` takes them. Of several that have a frame, the first named gives it.
Labels may come from other files than samples: a version of the dataset has labels and no samples, `inputs` the reverse.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from baselines.cache import FrameSource
from stone.errors import Refused
from stone_base.label_grid import PAPER, LabelGrid
from stone_exports.files import Files, FolderFiles, TarFiles
from stone_exports.frames import ExportedFrame, frames_in
from stone_exports.tables import EXPORTED, NotExportedError, exports_in
from stone_files.archives import tar_spans_of

LABELS = "gts"


def labelled_frames(
    paths: Sequence[Path], least_confidence: float = 0.0, grid: LabelGrid = PAPER
) -> tuple[FrameSource, ...]:
    """Every frame with samples, with its labels at this grid and of at least this confidence where there are some.

    Raises `NotExportedError`, `bad_tar`, `DamagedExportError`, and `nothing_to_train_on` where no frame has
    labels.
    """
    exports, stores = list[Files](), list[Files]()
    for path in paths:
        found = tuple(_label_stores(path))
        try:
            exports += exports_in(path)
        except NotExportedError:
            if not found:
                raise
        stores += found
    sources = tuple(replace(_with_labels(frame, stores, least_confidence), grid=grid) for frame in frames_of(exports))
    if all(source.labels is None for source in sources):
        raise nothing_to_train_on(paths)
    return sources


def frames_of(exports: Iterable[Files]) -> tuple[ExportedFrame, ...]:
    """Frames of several exports, each once, by sequence and stamp. Raises `DamagedExportError`."""
    found = dict[str, ExportedFrame]()
    for files in exports:
        for frame in frames_in(files):
            found.setdefault(frame.token, frame)
    return tuple(sorted(found.values(), key=lambda frame: (frame.sequence, frame.stamp_us)))


def _with_labels(frame: ExportedFrame, stores: Sequence[Files], least_confidence: float) -> FrameSource:
    name = f"{LABELS}/{frame.sequence}/{frame.token}/labels.npz"
    spans = (store.span(name) for store in stores)
    labels = frame.labels or next((span for span in spans if span is not None), None)
    return FrameSource(frame, labels, least_confidence)


def _label_stores(path: Path) -> Iterator[Files]:
    """A folder with `gts/`, a tar with one, or a folder of such tars."""
    if path.is_dir():
        if (path / LABELS).is_dir():
            yield FolderFiles(path)
        for child in sorted(path.glob("*.tar")):
            yield from _label_stores(child)
    elif path.suffix == ".tar":
        places = tar_spans_of(path, lambda name: EXPORTED.fullmatch(name) is not None)
        roots = {name[: name.index(f"{LABELS}/")] for name in places if f"{LABELS}/" in name}
        yield from (TarFiles(path, places, root) for root in sorted(roots))


def nothing_to_train_on(exports: Sequence[Path]) -> Refused:
    named = ", ".join(str(path) for path in exports[:3])
    return Refused(
        "nothing_to_train_on",
        f"{named} hold no frame with labels: expected are exports of `stone export --format nuscenes`, or inputs "
        "beside the tars of a dataset version (was an export of format inputs given alone?)",
    )
