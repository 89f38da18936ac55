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
    under = np.zeros(len(keys), np.bool_)
    if not len(keys):
        return under
    table, centres = table_of(keys), centres_of(keys, VOXEL_M)
    half = (footprint.length_m / 2, footprint.width_m / 2, band_m)
    low, high = centres.min(axis=0) - math.hypot(*half), centres.max(axis=0) + math.hypot(*half)
    for stretch in map_from_ego:
        poses = densified(stretch, STEP_M, STEP_RAD)
        is_near = ((low <= poses.translation_m) & (poses.translation_m <= high)).all(axis=1)
        _sweep(poses[is_near].as_matrix(), half, (table.keys, table.rows), under)
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
def _sweep(poses, half, table, under):  # type: ignore[no-untyped-def]
    reach = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    for p in range(poses.shape[0]):
        m = poses[p]
        low = (
            math.floor((m[0, 3] - reach) / VOXEL_M),
            math.floor((m[1, 3] - reach) / VOXEL_M),
            math.floor((m[2, 3] - reach) / VOXEL_M),
        )
        span = math.ceil(2 * reach / VOXEL_M) + 1
        for i in range(low[0], low[0] + span):
            for j in range(low[1], low[1] + span):
                for k in range(low[2], low[2] + span):
                    x = (i + 0.5) * VOXEL_M - m[0, 3]
                    y = (j + 0.5) * VOXEL_M - m[1, 3]
                    z = (k + 0.5) * VOXEL_M - m[2, 3]
                    if abs(m[0, 0] * x + m[1, 0] * y + m[2, 0] * z) > half[0]:
                        continue
                    if abs(m[0, 1] * x + m[1, 1] * y + m[2, 1] * z) > half[1]:
                        continue
                    if abs(m[0, 2] * x + m[1, 2] * y + m[2, 2] * z) > half[2]:
                        continue
                    row = find(table[0], table[1], pack(i, j, k))
                    if row >= 0:
                        under[row] = True
