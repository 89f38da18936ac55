"""Which voxels of a frame's grid a camera sees: in its image, and nothing labelled in between.

**Conventions.** Grid as in `stone.grid`. Line of sight is decided voxel by voxel outwards: how open the way to a voxel
is, is how open it is at the point one step nearer to the camera, interpolated between the four voxels around that
point (XDraw: Franklin & Ray, 1994); a voxel is seen when its way is at least half open. One neighbour instead of four
would bend every line towards the grid's axes. The steps depend on the calibration alone, so they are laid out once
per robot and each frame is one pass.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.calibration import CameraIntrinsics
from stone.grid import GRID_MIN_M, GRID_SHAPE, Grid
from stone.se3 import SE3
from stone.voxels import VOXEL_M

SOURCE = -1
OPEN = 240  # a way that nothing blocks; 16 × 15 levels fit a byte
NEAR_M = 0.1
RIM_M = 2 * VOXEL_M  # lines are followed so far around the image, else they would look around walls there


@dataclass(frozen=True, eq=False)
class SightLines:
    """Voxels in and around the image, nearest first: flat index `voxel` (S,), those of the four around the point one
    step nearer, `nearer` (S, 4), −1 at the source, and their `weight` (S, 4), which add up to `OPEN`; `is_inside` (S,)
    tells those in the image."""

    voxel: NDArray[np.int32]
    nearer: NDArray[np.int32]
    weight: NDArray[np.uint8]
    is_inside: NDArray[np.bool_]


def sight_lines(intrinsics: CameraIntrinsics, ego_from_camera: SE3) -> SightLines:
    """The sight lines of one camera through the grid.

    The image border is that of the undistorted pinhole: distortion bends lines within the image by less than a voxel
    at the ranges of the grid, and models that fold back would otherwise claim voxels behind the border.
    """
    camera = (ego_from_camera.translation_m - np.array(GRID_MIN_M)) / VOXEL_M
    planes = [_in_image(plane, intrinsics, ego_from_camera) for plane in range(GRID_SHAPE[0])]
    seen, inside = (np.concatenate(parts) for parts in zip(*planes, strict=True))
    index = np.stack(np.unravel_index(seen, GRID_SHAPE), axis=1).astype(np.float32)
    steps = np.linalg.norm(index + np.float32(0.5) - camera.astype(np.float32), axis=1)
    order = np.argsort(steps, kind="stable")
    seen, inside = seen[order], inside[order]
    nearer, weight = np.full((len(seen), 4), SOURCE, np.int32), np.zeros((len(seen), 4), np.uint8)
    _lay_out(seen, camera, nearer, weight)
    return SightLines(seen.astype(np.int32), nearer, weight, inside)


def mark_visible(classes: Grid, lines: SightLines, visible: Grid) -> None:
    """Set to 1 in `visible` (the grid's shape) what this camera sees of the scene `classes`."""
    flat = classes.reshape(-1)
    way = (flat == 0) * np.uint8(OPEN)  # where the image does not reach, only what is there blocks
    _look(flat, (lines.voxel, lines.nearer, lines.weight, lines.is_inside), way, visible.reshape(-1))


def _in_image(plane: int, k: CameraIntrinsics, ego_from_camera: SE3) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Of one plane of constant x: the voxels (flat) nearer than `RIM_M` to the image, and which are in it."""
    size = GRID_SHAPE[1] * GRID_SHAPE[2]
    flat = np.arange(plane * size, (plane + 1) * size)
    centres = (np.stack(np.unravel_index(flat, GRID_SHAPE), axis=1) + 0.5) * VOXEL_M + np.array(GRID_MIN_M)
    x, y, z = (ego_from_camera.inverse() @ centres).T
    depth = np.where(z > NEAR_M, z, np.inf)
    u, v = k.fx_px * x / depth + k.cx_px, k.fy_px * y / depth + k.cy_px
    rim_u, rim_v = RIM_M * k.fx_px / depth, RIM_M * k.fy_px / depth
    is_inside = (u >= 0) & (u < k.width_px) & (v >= 0) & (v < k.height_px) & (z > NEAR_M)
    is_near = (u >= -rim_u) & (u < k.width_px + rim_u) & (v >= -rim_v) & (v < k.height_px + rim_v) & (z > NEAR_M)
    return flat[is_near], is_inside[is_near]


@njit(cache=True, nogil=True)
def _lay_out(seen, camera, nearer, weight):  # type: ignore[no-untyped-def]
    plane, row = GRID_SHAPE[1] * GRID_SHAPE[2], GRID_SHAPE[2]
    for s in range(seen.size):
        at = (seen[s] // plane, (seen[s] % plane) // row, seen[s] % row)
        way = (camera[0] - (at[0] + 0.5), camera[1] - (at[1] + 0.5), camera[2] - (at[2] + 0.5))
        longest = max(abs(way[0]), abs(way[1]), abs(way[2]))
        if longest <= 1.0:
            weight[s, 0] = OPEN
            continue
        main = 0 if abs(way[0]) == longest else 1 if abs(way[1]) == longest else 2
        one, other = (main + 1) % 3, (main + 2) % 3
        step = 1 if way[main] > 0 else -1
        u, v = at[one] + way[one] / longest, at[other] + way[other] / longest
        left = OPEN
        for corner in range(4):
            du, dv = corner & 1, corner >> 1
            iu, iv = math.floor(u) + du, math.floor(v) + dv
            share = (1.0 - abs(u - iu)) * (1.0 - abs(v - iv))
            part = left if corner == 3 else min(left, round(share * OPEN))
            left -= part
            flat, inside = _flat(main, at[main] + step, iu, iv)
            weight[s, corner] = part
            nearer[s, corner] = flat if inside else SOURCE


@njit(inline="always")
def _flat(main, m, u, v):  # type: ignore[no-untyped-def]
    """(flat index, is in the grid) of the voxel at m on axis `main` and u, v on the two axes after it."""
    i, j, k = (m, u, v) if main == 0 else (v, m, u) if main == 1 else (u, v, m)
    inside = 0 <= i < GRID_SHAPE[0] and 0 <= j < GRID_SHAPE[1] and 0 <= k < GRID_SHAPE[2]
    return (i * GRID_SHAPE[1] + j) * GRID_SHAPE[2] + k, inside


@njit(cache=True, nogil=True)
def _look(classes, lines, way, visible):  # type: ignore[no-untyped-def]
    """`way`: how open the line of sight through each voxel is, 0 … `OPEN`; 0 where the voxel is labelled itself."""
    voxel, nearer, weight, is_inside = lines
    for s in range(voxel.size):
        total = 0
        for corner in range(4):
            n = nearer[s, corner]
            total += weight[s, corner] * (OPEN if n < 0 else way[n])
        reached = total // OPEN
        v = voxel[s]
        if 2 * reached >= OPEN and is_inside[s]:
            visible[v] = 1
        way[v] = 0 if classes[v] else reached
