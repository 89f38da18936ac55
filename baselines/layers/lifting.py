"""Lift, splat: features of images, spread along their rays by a distribution over depth, summed in voxels.

**Conventions.** Depth is along the camera's z. Bin i is centred at `min + i · step` and ends half a step to either
side. A cell of a feature map covers `stride` × `stride` pixels, and its ray passes through their middle (officially
through `linspace(0, size − 1)`, up to half a cell aside). All in float32 or more. Source: Philion and Fidler, Lift,
Splat, Shoot (ECCV 2020); `image2bev/ViewTransformerLSSVoxel.py` of OpenOccupancy and of OccFormer.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.batch import Batch
from baselines.lattice import VoxelLattice


@dataclass(frozen=True)
class Frustum:
    """Bins of depth over [min, max) m, `step_m` apart, along the rays of feature cells of `stride` pixels."""

    min_m: float = 2.0
    max_m: float = 58.0
    step_m: float = 0.5
    stride: int = 16

    @property
    def bins(self) -> int:
        return round((self.max_m - self.min_m) / self.step_m)

    def depths_m(self, like: Tensor) -> Tensor:
        """Return the middles of the bins (D,), in the type and on the device of `like`."""
        return self.min_m + self.step_m * torch.arange(self.bins, dtype=like.dtype, device=like.device)

    def points(self, image_from_camera: Tensor, grid_from_camera: Tensor, shape: tuple[int, int]) -> Tensor:
        """Return the positions of the bins of a map of h × w cells: (B, N, D, h, w, 3) m, in the grid frame.

        `image_from_camera` (B, N, 3, 3) is affine on pixels after the intrinsics, `grid_from_camera` (B, N, 4, 4).
        """
        height, width = (
            (torch.arange(n, dtype=image_from_camera.dtype, device=image_from_camera.device) + 0.5) * self.stride - 0.5
            for n in shape
        )
        v, u = torch.meshgrid(height, width, indexing="ij")
        pixels = torch.stack([u, v, torch.ones_like(u)], dim=-1)
        to_grid = grid_from_camera[:, :, :3, :3] @ torch.linalg.inv(image_from_camera)
        rays = torch.einsum("bnij,hwj->bnhwi", to_grid, pixels)[:, :, None]
        depths = self.depths_m(rays)[:, None, None, None]
        return rays * depths + grid_from_camera[:, :, None, None, None, :3, 3]

    def points_of(self, batch: Batch, shape: tuple[int, int]) -> Tensor:
        """Return the positions for a batch's cameras, out of autocast. Raises `ValueError` without cameras."""
        if batch.cameras is None:
            raise ValueError("this batch has no cameras")
        with torch.autocast(batch.device.type, enabled=False):
            return self.points(batch.cameras.image_from_camera(), batch.grid_from_camera(), shape)


def splat(depth: Tensor, context: Tensor, points: Tensor, lattice: VoxelLattice) -> Tensor:
    """Return the volume (B, C, X, Y, Z): in each voxel, the sum of depth · context over its points.

    `depth` (B, N, D, h, w) are probabilities over D, `context` (B, N, C, h, w), `points` (B, N, D, h, w, 3) m in the
    lattice's frame. Points outside of the lattice are ignored.
    """
    count, cameras, _, height, width = depth.shape
    channels, (x, y, z) = context.shape[2], lattice.shape
    index, is_inside = lattice.indices_of(points.reshape(-1, 3))
    seen = is_inside.nonzero().squeeze(1)
    frame, voxel_index = seen // points[0, ..., 0].numel(), index[seen]
    voxel = ((frame * x + voxel_index[:, 0]) * y + voxel_index[:, 1]) * z + voxel_index[:, 2]
    cells = height * width
    cell = seen // (depth.shape[2] * cells) * cells + seen % cells
    rows = context.permute(0, 1, 3, 4, 2).reshape(count * cameras * cells, channels)
    values = rows[cell] * depth.reshape(-1)[seen, None]
    volume = values.new_zeros(count * lattice.voxels(), channels).index_add_(0, voxel, values)
    return volume.reshape(count, x, y, z, channels).permute(0, 4, 1, 2, 3).contiguous()


def lift(depth_logits: Tensor, context: Tensor, points: Tensor, lattice: VoxelLattice) -> tuple[Tensor, Tensor]:
    """Return the volume of `splat`, and the probabilities of the logits (B, N, D, h, w); both out of autocast."""
    with torch.autocast(depth_logits.device.type, enabled=False):
        depth = depth_logits.to(points.dtype).softmax(dim=2)
        return splat(depth, context.to(points.dtype), points, lattice), depth
