"""What depth networks are trained towards: the LiDAR's depth at pixels.

**Conventions.** Depth is along z of the optical frame, metres; of several points at a pixel the nearest counts.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def depth_picture(
    points_ego: NDArray[np.float32],
    image_from_camera: NDArray[np.floating[Any]],
    camera_from_ego: NDArray[np.floating[Any]],
    size_px: tuple[int, int],
) -> NDArray[np.float32]:
    """(H, W) depth along z in metres of the nearest point (N, 3) at each pixel, 0 where there is none."""
    points = points_ego.astype(np.float64) @ camera_from_ego[:3, :3].T + camera_from_ego[:3, 3]
    points = points[points[:, 2] > 0.1]
    rays = points @ image_from_camera.T
    pixels = np.rint(rays[:, :2] / rays[:, 2:])
    is_inside = ((pixels >= 0) & (pixels < (size_px[1], size_px[0]))).all(axis=1)
    columns, rows = pixels[is_inside].astype(np.int64).T
    depth_m = np.full(size_px, np.inf, np.float32)
    np.minimum.at(depth_m, (rows, columns), points[is_inside, 2].astype(np.float32))
    return np.where(np.isfinite(depth_m), depth_m, np.float32(0))
