"""The columns of points that each camera sees, and their positions in its image.

**Conventions.** Points and cameras as in `baselines/batch.py`. A place is (column, row) as a fraction of an image's
width and height; pixel 0's centre is at half a pixel. Source: Li et al., BEVFormer, ECCV 2022, section 3.3; Huang et
al., TPVFormer, CVPR 2023; wzzheng/TPVFormer tpvformer04/modules/encoder.py (`point_sampling`, half a pixel off).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.batch import Batch
from baselines.layers.camera_projection import pixels_from_grid

NEAREST_M = 1e-5  # nearer points, and points behind the camera, are not seen
FAR_OUTSIDE = 2.0  # limit of places in widths or heights of an image; nothing outside is sampled


@dataclass(frozen=True, eq=False)
class CameraRig:
    """Projections (B, N, 3, 4) of the grid frame to homogeneous pixels, and rows and columns of the images."""

    pixels_from_grid: Tensor
    size_px: tuple[int, int]

    @staticmethod
    def of(batch: Batch) -> "CameraRig":
        """Return the rig of a batch. Raises `ValueError` without cameras."""
        if batch.cameras is None:
            raise ValueError("this batch has no cameras")
        height, width = batch.cameras.images.shape[-2:]
        with torch.autocast(batch.device.type, enabled=False):  # a pixel of a wide image needs more than 8 bits
            return CameraRig(pixels_from_grid(batch.cameras, batch.grid_from_camera()), (height, width))


@dataclass(frozen=True, eq=False)
class Sight:
    """The S of Q columns with a point in a camera's view: `columns` (S,) int64, `places` (S, D, 2) of their points."""

    columns: Tensor
    places: Tensor


@dataclass(frozen=True, eq=False)
class ColumnSights:
    """`sights` of each camera of each frame; `cameras` (B, Q) is how many of the N see the column."""

    sights: tuple[tuple[Sight, ...], ...]
    cameras: Tensor


@torch.no_grad()
def column_sights(points_grid: Tensor, rig: CameraRig, size_px: tuple[int, int]) -> ColumnSights:
    """Return how cameras see columns (Q, D, 3) of points.

    Places are fractions of `size_px`, rows and columns of the images after padding at their bottom and right.
    """
    with torch.autocast(points_grid.device.type, enabled=False):
        pixels, is_ahead = projected(points_grid, rig)
        places = (pixels + 0.5) / pixels.new_tensor((size_px[1], size_px[0]))
        places = torch.where(is_ahead[..., None], places, -FAR_OUTSIDE).clamp(-FAR_OUTSIDE, 1 + FAR_OUTSIDE)
        within = (pixels > -0.5) & (pixels < pixels.new_tensor((rig.size_px[1], rig.size_px[0])) - 0.5)
    is_seen = (within.all(dim=-1) & is_ahead).any(dim=-1)  # (B, N, Q)
    sights = tuple(
        tuple(Sight(seen.nonzero()[:, 0], where[seen]) for seen, where in zip(*frame, strict=True))
        for frame in zip(is_seen, places, strict=True)
    )
    return ColumnSights(sights, is_seen.sum(dim=1))


def projected(points_grid: Tensor, rig: CameraRig) -> tuple[Tensor, Tensor]:
    """Return pixels (B, N, Q, D, 2) of points (Q, D, 3) in each camera, and whether they are in front of it (B, N, Q,
    D).

    Pixels of points behind a camera are meaningless.
    """
    rotated = torch.einsum("bnij,qdj->bnqdi", rig.pixels_from_grid[..., :3], points_grid)
    rays = rotated + rig.pixels_from_grid[:, :, None, None, :, 3]
    depth_m = rays[..., 2]
    return rays[..., :2] / depth_m.clamp(min=NEAREST_M)[..., None], depth_m > NEAREST_M
