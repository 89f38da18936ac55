"""Agreement of labels with points of known class: ground in T ∪ P, obstacles in N."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.real.description import LabelledScan, Semantics
from benchmarks.real.errors import DescriptionError
from benchmarks.real.labelled_map import Figures
from benchmarks.real.measures import WrittenLabels
from benchmarks.real.opening import classes_of
from stone.labels.traversability import FREE, NON_TRAVERSABLE, TRAVERSABLE
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER

Counts = Mapping[int, NDArray[np.int64]]
NOTHING = np.zeros(4, np.int64)


def semantic_counts(labels: WrittenLabels, semantics: Semantics) -> Counts:
    """Return for every class of the labelled scans the number of its points in voxels of class 0 to 3 (4,).

    Points are placed by their own scan's frame. Points in T of a scan without poses are left out, because that T was
    declared, not labelled. Raises `DescriptionError`.
    """
    is_stated = labels.described.description.scan is not None
    totals: dict[int, NDArray[np.int64]] = {}
    for scan in semantics.scans:
        points, kinds = classes_of(labels.described, scan.points, scan.labels)
        points_ego = labels.sequence.calibration.ego_from_lidar @ points.astype(np.float64)
        index = np.floor((points_ego - PAPER.min_m) / VOXEL_M).astype(np.int64)
        inside = ((index >= 0) & (index < PAPER.shape)).all(axis=1)
        classes = labels.grid(_frame_of(labels, scan))[tuple(index[inside].T)]
        kinds = kinds[inside]
        judged = (classes != TRAVERSABLE) | (not is_stated)
        for kind in np.unique(kinds).tolist():
            here = np.bincount(classes[judged & (kinds == kind)], minlength=4)
            totals[kind] = totals.get(kind, NOTHING) + here
    return totals


def _frame_of(labels: WrittenLabels, scan: LabelledScan) -> int:
    if scan.stamp_ns is None:
        return 0
    frames = np.flatnonzero(labels.sequence.frames.stamps_ns == scan.stamp_ns)
    if len(frames) == 0:
        raise DescriptionError(labels.described.path, f"{scan.points}: no frame at stamp_ns {scan.stamp_ns}")
    return int(frames[0])


def agreement(counts: Counts, semantics: Semantics) -> Figures:
    """Return shares of the points in labelled voxels: ground classes in T or P, obstacles in N; and by class.

    `unlabelled`: the share of these points outside all labelled voxels, which are not judged.
    """
    ground = sum((counts.get(kind, NOTHING) for kind in semantics.ground.values()), NOTHING)
    obstacle = sum((counts.get(kind, NOTHING) for kind in semantics.obstacle.values()), NOTHING)
    known = ground + obstacle
    return {
        "ground_tp": _drivable(ground),
        "obstacle_n": _blocked(obstacle),
        "unlabelled": float(known[FREE] / known.sum()) if known.any() else None,
        **{f"T ∪ P of {name}": _drivable(counts.get(kind, NOTHING)) for name, kind in semantics.ground.items()},
        **{f"N of {name}": _blocked(counts.get(kind, NOTHING)) for name, kind in semantics.obstacle.items()},
    }


def _blocked(counts: NDArray[np.int64]) -> float | None:
    labelled = counts[FREE + 1 :].sum()
    return float(counts[NON_TRAVERSABLE] / labelled) if labelled else None


def _drivable(counts: NDArray[np.int64]) -> float | None:
    blocked = _blocked(counts)
    return None if blocked is None else 1.0 - blocked
