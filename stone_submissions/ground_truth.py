"""Ground truth on disk: `gts/<sequence>/<frame_token>/labels.npz`, as written by the labeler.

**Conventions.** `labels.npz` contains `semantics`, and optionally `mask_lidar`, `mask_camera` and `late`, uint8 with
the grid's shape. `confidence` is only read if a minimum confidence is required; `distance_squared` is never read. The
folder may be `gts` itself or its parent. All frames have one grid: the grid in `grid.json` next to `gts`, or the first
known grid with the first frame's shape. Evaluated voxels by mask: `all` is every voxel, as in the paper's tables, whose
0 mixes free and unknown; `lidar` and `camera` are the voxels whose mask is not 0.
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
    """A sequence's `tokens` in time order, its first stamp, and its drive if the drive has several sequences."""

    tokens: tuple[str, ...]
    first_stamp_ns: int
    drive: str | None = None


# Returns the sequences of a folder in time order, or None if the order is unknown.
FrameOrder = Callable[[Path, Mapping[str, Sequence[str]]], Mapping[str, TimedSequence] | None]
Grid = NDArray[np.uint8]
CONFIDENCE, LATE = "confidence", "late"
KEYS = frozenset({"semantics", "mask_lidar", "mask_camera", LATE, "distance_squared", CONFIDENCE})
MAX_LABELS_BYTES = 8 * 2**20


@dataclass(frozen=True)
class GroundTruth:
    """The label files of a folder: `paths` by frame token, and their manifest.

    If `timed` is known, frames are in time order inside each sequence; otherwise (None) they are in token order.
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
    """Return the frames with labels in this folder: sequences sorted by name, frames in the order that `order` returns.

    Without a `grid`, it is determined as above. Raises `UnreadableInputError` if the folder does not exist,
    `GroundTruthError` if it has no label file or an invalid name, `unknown_grid`, `bad_grid`, and the errors of
    `order`.
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
    in_time = manifest if ordered is None else Manifest({name: timed.tokens for name, timed in ordered.items()})
    truth = GroundTruth(root, in_time, mask, ordered)
    return replace(truth, manifest=replace(truth.manifest, grid=grid or _grid_at(truth)))


def _grid_at(truth: GroundTruth) -> LabelGrid:
    """Return the grid of a folder's labels. Raises `unknown_grid`, `bad_grid`, `GroundTruthError`."""
    for grid_path in (truth.folder / GRID_FILE, truth.folder.parent / GRID_FILE):
        if grid_path.is_file():
            return read_grid_file(grid_path)
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
    """The ground truth of one frame: its classes, the evaluated voxels, the late voxels (None if unknown), and the
    number of occupied voxels excluded for low confidence.
    """

    semantics: Grid
    is_evaluated: NDArray[np.bool_]
    is_late: NDArray[np.bool_] | None
    left_out: int = 0


def read_labels(path: Path, mask: Mask, grid: LabelGrid = PAPER, least_confidence: float = 0.0) -> FrameLabels:
    """Return the labels of one frame, checked as strictly as a submission; excludes occupied voxels of low confidence.

    Raises `UnreadableInputError`, `GroundTruthError` for any other file than the labeler's, and `no_confidence`.
    """
    return labels_in(read_bounded(path, MAX_LABELS_BYTES, GroundTruthError), mask, path, grid, least_confidence)


def labels_in(
    npz: bytes, mask: Mask, path: Path, grid: LabelGrid = PAPER, least_confidence: float = 0.0
) -> FrameLabels:
    """Return the labels in the bytes of a label file; `path` is used in errors. Raises `GroundTruthError`,
    `no_confidence`.
    """
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
    """Convert errors in a label file's bytes to `GroundTruthError`."""
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
