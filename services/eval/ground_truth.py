"""Ground truth on disk as bit planes for scoring; `stone_submissions/ground_truth.py` reads the files."""

from pathlib import Path

from stone.scoring.bitplanes import truth_planes
from stone.scoring.frame_counts import LabelRangeError, TruthPlanes
from stone_base.label_grid import PAPER, LabelGrid
from stone_submissions.errors import GroundTruthError
from stone_submissions.ground_truth import FrameLabels, Mask, labels_in, read_labels


def read_truth(path: Path, mask: Mask, grid: LabelGrid = PAPER) -> TruthPlanes:
    """Return the ground truth of one frame of a grid.

    Raises `UnreadableInputError`, and `GroundTruthError` for anything but a label file of the labeler.
    """
    return planes_of_labels(read_labels(path, mask, grid), path, grid)


def truth_in(npz: bytes, mask: Mask, path: Path, grid: LabelGrid = PAPER) -> TruthPlanes:
    """Return the ground truth in the bytes of a label file; `path` is only its name. Raises `GroundTruthError`."""
    return planes_of_labels(labels_in(npz, mask, path, grid), path, grid)


def planes_of_labels(labels: FrameLabels, path: Path, grid: LabelGrid) -> TruthPlanes:
    """Return the labels as planes. Raises `GroundTruthError` for values that are not classes."""
    try:
        return truth_planes(labels.semantics, labels.is_evaluated, grid, labels.is_late)
    except LabelRangeError as error:
        raise GroundTruthError(path, str(error)) from error
