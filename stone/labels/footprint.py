"""T, the voxels that the robot drove over: its footprint swept along the ego poses (paper, IV-C).

**Conventions.** The footprint is a rectangle in the ego xy plane, centred on the ego origin. A voxel is under it if its
centre is within the rectangle and within ± `band_m` of the plane. A wide band or a padded rectangle includes untouched
voxels and corrupts the reference.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.corners import corners_of
from stone.geometry.lattice import Keys, centres_of, find, pack, table_of
from stone.geometry.se3 import SE3, interpolate, steps_of
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Footprint
from stone.sensors.ground_plane import BAND_M

STEP_M = 0.1
STEP_RAD = 0.1


@dataclass(frozen=True, eq=False)
class Passes:
    """First and last pass of the robot over K voxels: `first_m` (K,) and `last_m` (K,) along its track; inf and −inf if
    it never passed.
    """

    first_m: NDArray[np.float64]
    last_m: NDArray[np.float64]

    @property
    def is_driven(self) -> NDArray[np.bool_]:
        """Whether the robot passed each voxel (K,)."""
        return np.isfinite(self.first_m)

    def where(self, keep: NDArray[np.bool_]) -> "Passes":
        return Passes(self.first_m[keep], self.last_m[keep])


def passes(
    keys: Keys, map_from_ego: Sequence[SE3], footprint: Footprint, band_m: float = BAND_M, start_m: float = 0.0
) -> Passes:
    """Return when the voxels `keys` (K,) were under the footprint, at or between the poses (P,) of a stretch.

    There is no motion between two stretches. The track starts at `start_m` and counts driven metres.
    """
    box = (footprint.length_m / 2, footprint.width_m / 2, -band_m, band_m)
    return _passes(keys, VOXEL_M, map_from_ego, box, start_m)


def passed_through(
    keys: Keys, voxel_m: float, map_from_ego: Sequence[SE3], footprint: Footprint, heights_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which voxels `keys` (K,) of this size the robot's body passed through: above its footprint, between two
    heights over the ego plane. Nothing solid can be there.
    """
    box = (footprint.length_m / 2, footprint.width_m / 2, *heights_m)
    return _passes(keys, voxel_m, map_from_ego, box, 0.0).is_driven


def _passes(
    keys: Keys, voxel_m: float, map_from_ego: Sequence[SE3], box: tuple[float, float, float, float], start_m: float
) -> Passes:
    """Return when the centre of each voxel is inside a moving box: half its length and width, its lowest and highest
    z.
    """
    result = Passes(np.full(len(keys), np.inf), np.full(len(keys), -np.inf))
    if not len(keys) or box[2] > box[3]:
        return result
    table, centres = table_of(keys), centres_of(keys, voxel_m)
    reach_m = math.hypot(box[0], box[1], max(abs(box[2]), abs(box[3])))
    low, high = corners_of(centres)
    low, high = low - reach_m, high + reach_m
    for stretch in map_from_ego:
        poses = densified(stretch, STEP_M, STEP_RAD)
        along_m = start_m + np.concatenate([[0.0], np.cumsum(steps_of(poses)[0])])
        is_near = np.asarray(((low <= poses.translation_m) & (poses.translation_m <= high)).all(axis=1), np.bool_)
        way = (poses[is_near].as_matrix(), along_m[is_near])
        _sweep(way, (*box, voxel_m), (table.keys, table.rows), (result.first_m, result.last_m))
        start_m = float(along_m[-1])
    return result


def densified(poses: SE3, step_m: float, step_rad: float = np.inf) -> SE3:
    """Return the poses with interpolated ones, so that neighbours are at most this far and this angle apart."""
    if len(poses) < 2:
        return poses
    lengths_m, angles_rad = steps_of(poses)
    pieces = np.maximum(1, np.ceil(np.maximum(lengths_m / step_m, angles_rad / step_rad))).astype(np.int64)
    left = np.repeat(np.arange(len(pieces)), pieces)
    ratio = (np.arange(len(left)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[left]
    between = interpolate(poses[left], poses[left + 1], ratio)
    return SE3(np.concatenate([between.wxyz_xyz, poses.wxyz_xyz[-1:]]))


@njit(cache=True, nogil=True)
def _sweep(way, box, table, first_and_last):  # type: ignore[no-untyped-def]
    (poses, along_m), (first_m, last_m) = way, first_and_last
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
                        first_m[row] = min(first_m[row], along_m[p])
                        last_m[row] = max(last_m[row], along_m[p])


@njit(inline="always")
def _reached(row, box):  # type: ignore[no-untyped-def]
    """Return the range [first, end) of voxels along one map axis, given by its `row` of the pose, that the box can
    cover.
    """
    length, width, bottom, top, voxel_m = box
    half = abs(row[0]) * length + abs(row[1]) * width + abs(row[2]) * max(abs(bottom), abs(top))
    return math.floor((row[3] - half) / voxel_m) - 1, math.floor((row[3] + half) / voxel_m) + 2
