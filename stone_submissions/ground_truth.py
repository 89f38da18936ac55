"""Ground truth on disk: `gts/<sequence>/<frame_token>/labels.npz`, as the labeler writes it.

**Conventions.** `labels.npz` holds `semantics`, and may hold `mask_lidar`, `mask_camera` and `late`, uint8 of the
grid's shape; the `distance_squared` of labels made with their confidence is not read, `confidence` only if a least one
is required.
The folder may be the one that holds `gts` or `gts` itself. All frames have one grid: that of `grid.json` beside `gts`,
or the first known grid of the shape of the first frame. Evaluated voxels by mask: `all` — every voxel, as the paper's
tables, whose 0 mixes free and unknown; `lidar`, `camera` — where that mask is not 0.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone_base.confidence import least_level, no_confidence
from stone_base.errors import Refused
from stone_base.label_grid import GRIDS, PAPER, LabelGrid, grid_of_shape
from stone_files.grid_file import GRID_FILE, read_grid_file
from stone_submissions.errors import GroundTruthError, SubmissionError, UnreadableInputError
from stone_submissions.manifest import MAX_FRAMES, SEQUENCE_NAME, Manifest, is_token, read_bounded
from stone_submissions.npz_frame import array_shape, npz_members, read_grid
from stone_submissions.zip_directory import ZipMember

Mask = Literal["all", "lidar", "camera"]


@dataclass(frozen=True)
class TimedSequence:
    """The `tokens` of a sequence in time order, its first stamp, and the drive of which it is one of several."""

    tokens: tuple[str, ...]
    first_stamp_ns: int
    drive: str | None = None


# The sequences of a folder of sequences in time; None where that is not known.
FrameOrder = Callable[[Path, Mapping[str, Sequence[str]]], Mapping[str, TimedSequence] | None]
Grid = NDArray[np.uint8]
CONFIDENCE, LATE = "confidence", "late"
KEYS = frozenset({"semantics", "mask_lidar", "mask_camera", LATE, "distance_squared", CONFIDENCE})
MAX_LABELS_BYTES = 8 * 2**20


@dataclass(frozen=True)
class GroundTruth:
    """The label files of a folder: `paths` by frame token, and the manifest they make.

    Frames are in time order inside each sequence if its `timed` is known, else (None) in that of their tokens.
    """

    folder: Path
    manifest: Manifest
    mask: Mask
    timed: Mapping[str, TimedSequence] | None

    def path(self, sequence: str, token: str) -> Path:
        return self.folder / sequence / token / "labels.npz"

    def paths(self) -> dict[str, Path]:
        sequences = self.manifest.sequences.items()
        return {token: self.path(sequence, token) for sequence, tokens in sequences for token in tokens}


def find_ground_truth(
    folder: Path, mask: Mask = "all", order: FrameOrder | None = None, grid: LabelGrid | None = None
) -> GroundTruth:
    """The frames that have labels in this folder, sequences in the order of their names, frames in that which `order`
    tells.

    Without a `grid` it is found (see above). Raises `UnreadableInputError` where there is no such folder,
    `GroundTruthError` where it holds no label file, a name that is none of ours, `unknown_grid`, `bad_grid`, and what
    `order` raises.
    """
    root = folder / "gts" if (folder / "gts").is_dir() else folder
    if not root.is_dir():
        raise UnreadableInputError(folder, "the folder does not exist")
    sequences: dict[str, list[str]] = {}
    for path in islice(sorted(root.glob("*/*/labels.npz")), MAX_FRAMES + 1):
        sequence, token = path.parts[-3:-1]
        if not (is_token(token) and SEQUENCE_NAME.fullmatch(sequence)):
            raise GroundTruthError(path, f"{token[:40]!r} is not a frame token of 32 hex digits")
        sequences.setdefault(sequence, []).append(token)
    manifest = Manifest({name: tuple(tokens) for name, tokens in sequences.items()})
    if not 0 < len(manifest.tokens) <= MAX_FRAMES:
        raise GroundTruthError(root, f"it has {len(manifest.tokens)} label files; 1 to {MAX_FRAMES} are allowed")
    if len(set(manifest.tokens)) < len(manifest.tokens):
        raise GroundTruthError(root, "two sequences share a frame token")
    ordered = None if order is None else order(root, manifest.sequences)
    in_time = manifest if ordered is None else Manifest({name: one.tokens for name, one in ordered.items()})
    found = GroundTruth(root, in_time, mask, ordered)
    return replace(found, manifest=replace(found.manifest, grid=grid or _grid_at(found)))


def _grid_at(truth: GroundTruth) -> LabelGrid:
    """The grid of a folder's labels. Raises `unknown_grid`, `bad_grid`, `GroundTruthError`."""
    for place in (truth.folder / GRID_FILE, truth.folder.parent / GRID_FILE):
        if place.is_file():
            return read_grid_file(place)
    path = next(iter(truth.paths().values()))
    npz = read_bounded(path, MAX_LABELS_BYTES, GroundTruthError)
    with _refusals(path):
        shape = array_shape(npz, _members(npz)["semantics"])
    known = grid_of_shape(shape)
    if known is None:
        raise unknown_grid(path, shape)
    return known


def unknown_grid(path: Path, shape: tuple[int, ...]) -> Refused:
    return Refused(
        "unknown_grid",
        f"{path} has labels of shape {str(shape)[:60]}, which none of the grids {', '.join(GRIDS)} has; set "
        f"their grid with --grid or in {GRID_FILE} next to gts",
    )


@dataclass(frozen=True, eq=False)
class FrameLabels:
    """The ground truth of one frame: its classes, which voxels are evaluated, which are late (None if unknown), and how
    many occupied voxels are left out for their confidence."""

    semantics: Grid
    is_evaluated: NDArray[np.bool_]
    is_late: NDArray[np.bool_] | None
    left_out: int = 0


def read_labels(path: Path, mask: Mask, grid: LabelGrid = PAPER, least_confidence: float = 0.0) -> FrameLabels:
    """The labels of one frame of a grid, read as strictly as a submission is, without its occupied voxels of a lower
    confidence.

    Raises `UnreadableInputError`, `GroundTruthError` for anything but a label file of the labeler, and `no_confidence`.
    """
    return labels_in(read_bounded(path, MAX_LABELS_BYTES, GroundTruthError), mask, path, grid, least_confidence)


def labels_in(
    npz: bytes, mask: Mask, path: Path, grid: LabelGrid = PAPER, least_confidence: float = 0.0
) -> FrameLabels:
    """The labels in the bytes of a label file, which `path` only names. Raises `GroundTruthError`, `no_confidence`."""
    with _refusals(path):
        members = _members(npz)
        semantics = read_grid(npz, members["semantics"], grid)
        is_evaluated = np.ones(grid.shape, np.bool_)
        if mask != "all":
            is_evaluated = read_grid(npz, members[f"mask_{mask}"], grid) != 0
        is_late = read_grid(npz, members[LATE], grid) != 0 if LATE in members else None
        if least_confidence <= 0:
            return FrameLabels(semantics, is_evaluated, is_late)
        if CONFIDENCE not in members:
            raise no_confidence(path)
        is_unsure = (semantics != 0) & (read_grid(npz, members[CONFIDENCE], grid) < least_level(least_confidence))
    left_out = int(np.count_nonzero(is_unsure & is_evaluated))
    return FrameLabels(semantics, is_evaluated & ~is_unsure, is_late, left_out)


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Turn what is wrong with the bytes of a label file into a `GroundTruthError`."""
    try:
        yield
    except (SubmissionError, KeyError) as error:
        fault = f"no array {error}" if isinstance(error, KeyError) else str(error)
        raise GroundTruthError(path, fault) from error


def _members(npz: bytes) -> dict[str, ZipMember]:
    members = npz_members(npz)
    extra = sorted(set(members) - KEYS)
    if extra:
        raise KeyError(f"other than {', '.join(sorted(KEYS))} is allowed, but the file has {extra[0]}")
    return members
