"""The frames for training, validation and prediction: frames of exports, with labels of theirs or of a dataset version.

**Conventions.** Sources are those of `stone baseline`. The first source with a frame provides it. Labels may come from
other files than samples: a version of the dataset has labels and no samples, `inputs` the reverse. A published ZIP is
read in place. Manifests among the sources select frames.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from baselines.cache import FrameSource
from baselines.frame_record import ALL_LABELS, WantedLabels
from stone.errors import Refused
from stone_datasets.placed_frames import swept_frames
from stone_exports.files import Files, FolderFiles, TarFiles
from stone_exports.frames import ExportedFrame, frames_in
from stone_exports.tables import EXPORTED, NotExportedError, exports_in
from stone_files.archives import tar_spans_of
from stone_files.dataset_layout import is_zip
from stone_submissions.manifest import read_manifest

LABELS, MANIFEST = "gts", ".json"


def labelled_frames(paths: Sequence[Path], wanted: WantedLabels = ALL_LABELS) -> tuple[FrameSource, ...]:
    """Return every frame with samples, with its wanted labels if it has any.

    Raises `NotExportedError`, `bad_tar`, `DamagedExportError`, `bad_manifest`, a `DatasetFaultError`, and
    `nothing_to_train_on` if no frame has labels.
    """
    stores = [store for path in paths for store in _label_stores(path)]
    sources = tuple(_with_labels(frame, stores, wanted) for frame in frames_at(paths))
    if all(source.labels is None for source in sources):
        raise nothing_to_train_on(paths)
    return sources


def frames_at(paths: Sequence[Path]) -> tuple[ExportedFrame, ...]:
    """Return the frames of several exports and published ZIPs, each once, by sequence and stamp.

    If manifests are given, only their frames are returned. Raises `NotExportedError`, `bad_tar`, `DamagedExportError`,
    `bad_manifest`, a `DatasetFaultError`.
    """
    frames, named = dict[str, ExportedFrame](), [path for path in paths if path.suffix == MANIFEST]
    tokens = {token for path in named for token in read_manifest(path).tokens}
    for path in paths:
        for frame in () if path in named else _frames_of(path):
            if not named or frame.token in tokens:
                frames.setdefault(frame.token, frame)
    return tuple(sorted(frames.values(), key=lambda frame: (frame.sequence, frame.stamp_us)))


def _frames_of(path: Path) -> Iterator[ExportedFrame]:
    if is_zip(path):
        yield from swept_frames(path)
        return
    try:
        exports = exports_in(path)
    except NotExportedError:
        if not any(_label_stores(path)):
            raise
        return
    for files in exports:
        yield from frames_in(files)


def _with_labels(frame: ExportedFrame, stores: Sequence[Files], wanted: WantedLabels) -> FrameSource:
    name = f"{LABELS}/{frame.sequence}/{frame.token}/labels.npz"
    spans = (store.span(name) for store in stores)
    labels = frame.labels or next((span for span in spans if span is not None), None)
    return FrameSource(frame, labels, wanted)


def _label_stores(path: Path) -> Iterator[Files]:
    """Yield a folder with `gts/`, a tar with one, or a folder of such tars."""
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
        f"{named} contain no frame with labels: expected exports of `stone export --format nuscenes`, or inputs "
        "beside the tars of a dataset version (was an export of format inputs given alone?)",
    )
