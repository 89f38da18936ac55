"""The voxel lattice of a model's predictions: the benchmark's grid, a part of it, or a coarser grid.

**Conventions.** Axes x, y, z of the ego frame, in that order, C order; a voxel's index is `floor((p − min) / size)`.
"""

from dataclasses import dataclass
from math import isclose

import torch
from torch import Tensor

from stone_base.label_grid import PAPER, LabelGrid

Triple = tuple[float, float, float]
Shape = tuple[int, int, int]


@dataclass(frozen=True)
class VoxelLattice:
    """Voxels of `voxel_m` metres from the corner `min_m`, `shape` of them along x, y, z."""

    min_m: Triple = PAPER.min_m
    voxel_m: Triple = (PAPER.voxel_m, PAPER.voxel_m, PAPER.voxel_m)
    shape: Shape = PAPER.shape

    @classmethod
    def of(cls, grid: LabelGrid) -> "VoxelLattice":
        """Return the whole lattice of a label grid."""
        return cls(grid.min_m, (grid.voxel_m, grid.voxel_m, grid.voxel_m), grid.shape)

    @property
    def max_m(self) -> Triple:
        x, y, z = (low + size * n for low, size, n in zip(self.min_m, self.voxel_m, self.shape, strict=True))
        return x, y, z

    def coarser(self, ratio: int | Shape) -> "VoxelLattice":
        """Return the same volume in voxels `ratio` times as long. Raises `ValueError` if `ratio` does not fit."""
        ratios = (ratio, ratio, ratio) if isinstance(ratio, int) else ratio
        if any(n % r for n, r in zip(self.shape, ratios, strict=True)):
            raise ValueError(f"a lattice of {self.shape} voxels cannot be made {ratios} times coarser")
        sizes = [size * r for size, r in zip(self.voxel_m, ratios, strict=True)]
        counts = [n // r for n, r in zip(self.shape, ratios, strict=True)]
        return VoxelLattice(self.min_m, (sizes[0], sizes[1], sizes[2]), (counts[0], counts[1], counts[2]))

    def voxels(self) -> int:
        x, y, z = self.shape
        return x * y * z

    def centres_m(self, device: torch.device | None = None) -> Tensor:
        """Return the centres of all voxels (X, Y, Z, 3), float32, ego frame."""
        axes = [
            low + size * (torch.arange(n, device=device, dtype=torch.float32) + 0.5)
            for low, size, n in zip(self.min_m, self.voxel_m, self.shape, strict=True)
        ]
        return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)

    def indices_of(self, points_ego: Tensor) -> tuple[Tensor, Tensor]:
        """Return the voxel indices (N, 3) int64 of points (N, 3), and which of them (N,) are in the lattice.

        Indices of points outside, NaN among them, are 0.
        """
        low, size = points_ego.new_tensor(self.min_m), points_ego.new_tensor(self.voxel_m)
        voxel = torch.floor((points_ego - low) / size)
        is_inside = ((voxel >= 0) & (voxel < voxel.new_tensor(self.shape))).all(dim=1)
        return torch.where(is_inside[:, None], voxel, voxel.new_zeros(())).long(), is_inside

    def is_whole(self, grid: LabelGrid) -> bool:
        """Return whether a prediction on the lattice covers all of the grid."""
        whole = VoxelLattice.of(grid)
        places = zip((*self.min_m, *self.voxel_m), (*whole.min_m, *whole.voxel_m), strict=True)
        return self.shape == grid.shape and all(isclose(a, b) for a, b in places)


def grid_part(lattice: VoxelLattice, grid: LabelGrid) -> tuple[slice, slice, slice]:
    """Return the part of a label grid that the lattice covers. Raises `ValueError` if the grid does not contain it."""
    corner = [round((low - of_grid) / grid.voxel_m) for low, of_grid in zip(lattice.min_m, grid.min_m, strict=True)]
    ends = [begin + count for begin, count in zip(corner, lattice.shape, strict=True)]
    fits = all(begin >= 0 and end <= side for begin, end, side in zip(corner, ends, grid.shape, strict=True))
    if not fits or any(abs(size - grid.voxel_m) > 1e-6 for size in lattice.voxel_m):
        raise ValueError(f"a lattice of {lattice.shape} voxels at {lattice.min_m} is not part of the grid {grid}")
    x, y, z = (slice(begin, end) for begin, end in zip(corner, ends, strict=True))
    return x, y, z
