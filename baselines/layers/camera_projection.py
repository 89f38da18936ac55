"""Camera features on a voxel lattice by projection: the mean over the cameras that see a voxel's centre.

**Conventions.** A cell (row, column) of features of h × w over an image of H × W covers the pixels of its area: `column
= floor((u + ½) w / W)`. Voxels outside all cameras' views are 0. Computed in float32 outside autocast. Source: Ming et
al., OccFusion, IEEE T-IV 2024 (view transformation without depth).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from baselines.batch import CameraViews
from baselines.lattice import VoxelLattice

NEAREST_M = 0.1  # projections closer to the camera's plane are meaningless


class ProjectedFeatures(NamedTuple):
    """`volume` (B, C, X, Y, Z): mean of the cells around a voxel's centre in the images. `bev` (B, C, X, Y): the mean
    over its column's voxels, with equal weights of all sightings.
    """

    volume: Tensor
    bev: Tensor


def pixels_from_grid(views: CameraViews, grid_from_camera: Tensor) -> Tensor:
    """Return the projection (B, N, 3, 4) of the grid frame to homogeneous pixels of `views.images`; the third number is
    depth in m.
    """
    camera_from_grid: Tensor = torch.linalg.inv(grid_from_camera)
    return views.image_from_camera() @ camera_from_grid[..., :3, :]


def seen_cells(
    points_grid: Tensor, pixels_from_grid: Tensor, image: tuple[int, int], cells: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """Return which points (P, 3) one camera sees, (S,) int64 ascending, and the flat cell (S,) of `cells` of each.

    `pixels_from_grid` is (3, 4); `image` and `cells` are heights and widths. NaN is not seen.
    """
    rays = points_grid @ pixels_from_grid[:, :3].T + pixels_from_grid[:, 3]
    depth_m = rays[:, 2]
    pixels = rays[:, :2] / depth_m[:, None].clamp(min=NEAREST_M)
    size = pixels.new_tensor([cells[1] / image[1], cells[0] / image[0]])
    cell = torch.floor((pixels + 0.5) * size)
    is_seen = (depth_m > NEAREST_M) & ((cell >= 0) & (cell < cell.new_tensor([cells[1], cells[0]]))).all(dim=1)
    seen = is_seen.nonzero()[:, 0]
    column, row = cell[seen].long().unbind(dim=1)
    return seen, row * cells[1] + column


class Sightings(NamedTuple):
    """Sightings of points: `total` (B, P, C) of the cells around each, `cameras` (B, P, 1), the number that see it."""

    total: Tensor
    cameras: Tensor

    def means(self) -> Tensor:
        return self.total / self.cameras.clamp(min=1)


def sightings_of(points_grid: Tensor, features: Tensor, views: CameraViews, grid_from_camera: Tensor) -> Sightings:
    """Return the sightings of grid points (B, P, 3) in features (B, N, C, h, w) of the images of `views`."""
    image = (views.images.shape[-2], views.images.shape[-1])
    with torch.autocast(features.device.type, enabled=False):
        matrices = pixels_from_grid(views, grid_from_camera).float()
        frames = zip(points_grid, features.float(), matrices, strict=True)
        sums = [_sums(cells, of, points, image) for points, cells, of in frames]
    return Sightings(torch.stack([total for total, _ in sums]), torch.stack([count for _, count in sums])[..., None])


def project_features(
    features: Tensor, views: CameraViews, grid_from_camera: Tensor, lattice: VoxelLattice
) -> ProjectedFeatures:
    """Return features (B, N, C, h, w) of the images of `views`, on `lattice` in the grid frame."""
    centres = lattice.centres_m(features.device).reshape(1, -1, 3).expand(len(features), -1, -1)
    seen = sightings_of(centres, features, views, grid_from_camera)
    shape = (len(features), *lattice.shape, -1)
    volume = seen.means().reshape(shape)
    columns = Sightings(seen.total.reshape(shape).sum(dim=3), seen.cameras.reshape(shape).sum(dim=3))
    return ProjectedFeatures(volume.permute(0, 4, 1, 2, 3), columns.means().permute(0, 3, 1, 2))


def _sums(features: Tensor, matrices: Tensor, centres: Tensor, image: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return the sums (P, C) of one frame's features (N, C, h, w) at the centres, and the number of cameras per centre
    (P,).
    """
    total = features.new_zeros(len(centres), features.shape[1])
    count = features.new_zeros(len(centres))
    for cells, matrix in zip(features, matrices, strict=True):
        seen, cell = seen_cells(centres, matrix, image, (cells.shape[1], cells.shape[2]))
        total = total.index_add(0, seen, cells.flatten(1).T[cell])
        count = count.index_add(0, seen, count.new_ones(len(seen)))
    return total, count
