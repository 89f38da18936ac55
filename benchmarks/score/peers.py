"""Other implementations of counting the same frames, and the minimum memory traffic.

**Conventions.** Each takes frames by token and returns their confusion [truth, prediction]; none checks more than numpy
does. `occ3d` follows the evaluation of CVPR2023-3D-Occupancy-Prediction and Occ3D (`Metric_mIoU.add_batch` and
`hist_info`, and the loop of `evaluate` that loads each label file), with four classes.
"""

import io
import zipfile
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.score.material import Material
from stone_base.label_grid import LabelGrid

CLASSES = 4
Counts = NDArray[np.int64]
Words = NDArray[np.uint64]


def occ3d(archive: zipfile.ZipFile, data: Material, tokens: Sequence[str]) -> Counts:
    """Count with `np.load` of prediction and labels, three fancy-indexed copies, and `bincount` of int64."""
    total = np.zeros((CLASSES, CLASSES))
    for token in tokens:
        prediction = np.load(io.BytesIO(archive.read(f"{token}.npz")))["semantics"]
        labels = np.load(data.label_path(token))
        truth, mask_lidar = labels["semantics"], labels["mask_lidar"].astype(bool)
        labels["mask_camera"].astype(bool)
        total += _hist_info(prediction[mask_lidar].flatten(), truth[mask_lidar].flatten())
    return total.astype(np.int64)


def _hist_info(pred: NDArray[np.uint8], gt: NDArray[np.uint8]) -> NDArray[np.float64]:
    k = (gt >= 0) & (gt < CLASSES)
    np.sum(k)
    np.sum(pred[k] == gt[k])
    pairs = CLASSES * gt[k].astype(int) + pred[k].astype(int)
    return np.bincount(pairs, minlength=CLASSES**2).reshape(CLASSES, CLASSES).astype(np.float64)


class Plain:
    """A straightforward implementation: `np.load` of the prediction, `bincount` of the evaluated pairs; labels in
    memory.
    """

    def __init__(self, data: Material, tokens: Sequence[str]) -> None:
        self._labels = {}
        for token in tokens:
            with np.load(data.label_path(token)) as labels:
                self._labels[token] = labels["semantics"], labels["mask_lidar"].astype(bool)

    def __call__(self, archive: zipfile.ZipFile, tokens: Sequence[str]) -> Counts:
        total = np.zeros(CLASSES**2, np.int64)
        for token in tokens:
            truth, is_evaluated = self._labels[token]
            prediction = np.load(io.BytesIO(archive.read(f"{token}.npz")))["semantics"]
            pairs = CLASSES * truth[is_evaluated].astype(np.int64) + prediction[is_evaluated]
            total += np.bincount(pairs, minlength=CLASSES**2)
        return total.reshape(CLASSES, CLASSES)


class ByteMoving:
    """The floor: write a frame's voxels into allocated memory, read them, read its truth planes."""

    def __init__(self, grid: LabelGrid) -> None:
        self._inflated = np.random.default_rng(0).integers(0, CLASSES, grid.voxels, np.uint8)
        self._written = np.empty_like(self._inflated)

    def __call__(self, data: Material, tokens: Sequence[str]) -> int:
        seen = np.uint64(0)
        for token in tokens:
            np.copyto(self._written, self._inflated)
            seen |= _read(self._written.view(np.uint64)) | _read(data.planes_of(token).planes.reshape(-1))
        return int(seen)


@njit(nogil=True)
def _read(words: Words) -> np.uint64:
    seen = np.uint64(0)
    for at in range(words.size):  # by index: a loop over the words themselves is not vectorised, and three times slower
        seen |= words[at]
    return seen
