"""T, the voxels the robot drove on: its footprint swept along the ego poses (paper, IV-C).

**Conventions.** The footprint is a rectangle in the ego xy plane, centred on the ego origin; a voxel is under it when
its centre is within the rectangle and within ± `band_m` of the plane. A wide band or a padded rectangle takes in what
the robot did not touch and poisons the reference.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.corners import corners_of
from stone.geometry.lattice import Keys, centres_of, find, pack, table_of
from stone.geometry.se3 import SE3, interpolate, steps_of
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Footprint

BAND_M = 0.15
STEP_M = 0.1
STEP_RAD = 0.1


def swept(keys: Keys, map_from_ego: Sequence[SE3], footprint: Footprint, band_m: float = BAND_M) -> NDArray[np.bool_]:
    """Which of the voxels `keys` (K,) lie under the footprint at, or on the way between, the poses (P,) of a stretch.

    Between two stretches there is no way.
    """
    return _swept(keys, VOXEL_M, map_from_ego, (footprint.length_m / 2, footprint.width_m / 2, -band_m, band_m))


def passed_through(
    keys: Keys, voxel_m: float, map_from_ego: Sequence[SE3], footprint: Footprint, heights_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """Which of the voxels `keys` (K,) of this size the robot's body went through: above its footprint, between two
    heights over the ego plane. Nothing that stands can be there."""
    return _swept(keys, voxel_m, map_from_ego, (footprint.length_m / 2, footprint.width_m / 2, *heights_m))


def _swept(
    keys: Keys, voxel_m: float, map_from_ego: Sequence[SE3], box: tuple[float, float, float, float]
) -> NDArray[np.bool_]:
    """Which voxels have their centre in a box that goes along: half its length and width, its lowest and highest z."""
    under = np.zeros(len(keys), np.bool_)
    if not len(keys) or box[2] > box[3]:
        return under
    table, centres = table_of(keys), centres_of(keys, voxel_m)
    reach_m = math.hypot(box[0], box[1], max(abs(box[2]), abs(box[3])))
    low, high = corners_of(centres)
    low, high = low - reach_m, high + reach_m
    for stretch in map_from_ego:
        poses = densified(stretch, STEP_M, STEP_RAD)
        is_near = np.asarray(((low <= poses.translation_m) & (poses.translation_m <= high)).all(axis=1), np.bool_)
        _sweep(poses[is_near].as_matrix(), (*box, voxel_m), (table.keys, table.rows), under)
    return under


def densified(poses: SE3, step_m: float, step_rad: float = np.inf) -> SE3:
    """The poses with others interpolated between, so that neighbours are at most so far apart and turned."""
    if len(poses) < 2:
        return poses
    lengths_m, angles_rad = steps_of(poses)
    pieces = np.maximum(1, np.ceil(np.maximum(lengths_m / step_m, angles_rad / step_rad))).astype(np.int64)
    left = np.repeat(np.arange(len(pieces)), pieces)
    ratio = (np.arange(len(left)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[left]
    between = interpolate(poses[left], poses[left + 1], ratio)
    return SE3(np.concatenate([between.wxyz_xyz, poses.wxyz_xyz[-1:]]))


@njit(cache=True, nogil=True)
def _sweep(poses, box, table, under):  # type: ignore[no-untyped-def]
    length, width, bottom, top, voxel_m = box
    for p in range(poses.shape[0]):
        m = poses[p]
        for i in range(*_reached(m[0], box)):
            for j in range(*_reached(m[1], box)):
                for k in range(*_reached(m[2], box)):
                    x = (i + 0.5) * voxel_m - m[0, 3]
                    y = (j + 0.5) * voxel_m - m[1, 3]
                    z = (k + 0.5) * voxel_m - m[2, 3]
                    if abs(m[0, 0] * x + m[1, 0] * y + m[2, 0] * z) > length:
                        continue
                    if abs(m[0, 1] * x + m[1, 1] * y + m[2, 1] * z) > width:
                        continue
                    if not bottom <= m[0, 2] * x + m[1, 2] * y + m[2, 2] * z <= top:
                        continue
                    row = find(table[0], table[1], pack(i, j, k))
                    if row >= 0:
                        under[row] = True


@njit(inline="always")
def _reached(row, box):  # type: ignore[no-untyped-def]
    """The voxels [first, end) along one axis of the map, whose row of the pose this is, that the box can lie over."""
    length, width, bottom, top, voxel_m = box
    half = abs(row[0]) * length + abs(row[1]) * width + abs(row[2]) * max(abs(bottom), abs(top))
    return math.floor((row[3] - half) / voxel_m) - 1, math.floor((row[3] + half) / voxel_m) + 2
