"""Which voxels of a frame's grid a camera sees: in its image, and nothing labelled in between.

**Conventions.** Grid as in `stone.grid`. Line of sight is decided voxel by voxel outwards: a voxel is seen when it
is in the image and the voxel one step nearer to the camera is seen and free (or is the camera's own). The steps
depend on the calibration alone, so they are laid out once per robot and each frame is one pass.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.calibration import CameraIntrinsics
from stone.grid import GRID_MIN_M, GRID_SHAPE, Grid
from stone.se3 import SE3
from stone.voxels import VOXEL_M

SOURCE = -1
NEAR_M = 0.1


@dataclass(frozen=True, eq=False)
class SightLines:
    """Voxels in the image, nearest first: flat index `voxel` (S,) and that of the next nearer one, `nearer` (S,)."""

    voxel: NDArray[np.int32]
    nearer: NDArray[np.int32]


def sight_lines(intrinsics: CameraIntrinsics, ego_from_camera: SE3) -> SightLines:
    """The sight lines of one camera through the grid.

    The image border is that of the undistorted pinhole: distortion bends lines within the image by less than a voxel
    at the ranges of the grid, and models that fold back would otherwise claim voxels behind the border.
    """
    camera = (ego_from_camera.translation_m - np.array(GRID_MIN_M)) / VOXEL_M
    seen = np.concatenate([_in_image(plane, intrinsics, ego_from_camera) for plane in range(GRID_SHAPE[0])])
    index = np.stack(np.unravel_index(seen, GRID_SHAPE), axis=1).astype(np.float32)
    steps = np.linalg.norm(index + np.float32(0.5) - camera.astype(np.float32), axis=1)
    seen = seen[np.argsort(steps, kind="stable")]
    nearer = np.empty(len(seen), np.int32)
    _lay_out(seen, camera, nearer)
    return SightLines(seen.astype(np.int32), nearer)


def mark_visible(classes: Grid, lines: SightLines, visible: Grid) -> None:
    """Set to 1 in `visible` (the grid's shape) what this camera sees of the scene `classes`."""
    reached = np.zeros(classes.size, np.uint8)
    _look(classes.reshape(-1), lines.voxel, lines.nearer, reached, visible.reshape(-1))


def _in_image(plane: int, k: CameraIntrinsics, ego_from_camera: SE3) -> NDArray[np.int64]:
    """Flat indices of the voxels of one plane of constant x that project into the image."""
    size = GRID_SHAPE[1] * GRID_SHAPE[2]
    flat = np.arange(plane * size, (plane + 1) * size)
    centres = (np.stack(np.unravel_index(flat, GRID_SHAPE), axis=1) + 0.5) * VOXEL_M + np.array(GRID_MIN_M)
    x, y, z = (ego_from_camera.inverse() @ centres).T
    depth = np.where(z > NEAR_M, z, np.inf)
    u, v = k.fx_px * x / depth + k.cx_px, k.fy_px * y / depth + k.cy_px
    is_inside = (u >= 0) & (u < k.width_px) & (v >= 0) & (v < k.height_px)
    return np.asarray(flat[is_inside & (z > NEAR_M)], dtype=np.int64)


@njit(cache=True, nogil=True)
def _lay_out(seen, camera, nearer):  # type: ignore[no-untyped-def]
    plane, row = GRID_SHAPE[1] * GRID_SHAPE[2], GRID_SHAPE[2]
    for s in range(seen.size):
        i, j, k = seen[s] // plane, (seen[s] % plane) // row, seen[s] % row
        dx, dy, dz = camera[0] - (i + 0.5), camera[1] - (j + 0.5), camera[2] - (k + 0.5)
        scale = 1.0 / max(abs(dx), abs(dy), abs(dz), 1.0)
        ni, nj, nk = round(i + dx * scale), round(j + dy * scale), round(k + dz * scale)
        is_source = max(abs(dx), abs(dy), abs(dz)) <= 1.0
        outside = not (0 <= ni < GRID_SHAPE[0] and 0 <= nj < GRID_SHAPE[1] and 0 <= nk < GRID_SHAPE[2])
        nearer[s] = SOURCE if is_source or outside else (ni * GRID_SHAPE[1] + nj) * GRID_SHAPE[2] + nk


@njit(cache=True, nogil=True)
def _look(classes, voxel, nearer, reached, visible):  # type: ignore[no-untyped-def]
    """`reached`: 1 seen and free, 2 seen and labelled (nothing behind it is), 3 in the image and hidden."""
    for s in range(voxel.size):
        v, n = voxel[s], nearer[s]
        # a nearer voxel outside the image (reached 0) hides nothing: the ray enters the image there
        is_open = n == SOURCE or reached[n] == 1 or (reached[n] == 0 and classes[n] == 0)
        if is_open:
            reached[v] = 2 if classes[v] else 1
            visible[v] = 1
        else:
            reached[v] = 3
