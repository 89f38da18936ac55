"""Features of the occupied voxels only, in the order of their keys.

**Conventions.** A voxel's key is `((frame · X + x) · Y + y) · Z + z`, int64; keys are ascending and each occurs once.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from baselines.batch import Points
from baselines.lattice import Shape, VoxelLattice


@dataclass(frozen=True, eq=False)
class SparseVoxels:
    """Features (V, C) of the voxels with `keys` (V,), of `frames` lattices of `shape`."""

    features: Tensor
    keys: Tensor
    shape: Shape
    frames: int

    def with_features(self, features: Tensor) -> "SparseVoxels":
        return replace(self, features=features)

    def indices(self) -> Tensor:
        """(V, 4) int64: frame, x, y, z."""
        return indices_of(self.keys, self.shape)

    def dense(self) -> Tensor:
        """(B, C, X, Y, Z), 0 where no voxel is."""
        x, y, z = self.shape
        volume = self.features.new_zeros(self.frames * x * y * z, self.features.shape[1])
        volume = volume.index_copy(0, self.keys, self.features)
        return volume.view(self.frames, x, y, z, -1).permute(0, 4, 1, 2, 3).contiguous()


def keys_of(indices: Tensor, shape: Shape) -> Tensor:
    """Keys (V,) of indices (V, 4)."""
    x, y, z = shape
    return ((indices[:, 0] * x + indices[:, 1]) * y + indices[:, 2]) * z + indices[:, 3]


def indices_of(keys: Tensor, shape: Shape) -> Tensor:
    """Indices (V, 4) of keys (V,)."""
    x, y, z = shape
    return torch.stack([keys // (x * y * z), keys // (y * z) % x, keys // z % y, keys % z], dim=1)


def means_of_points(points: Points, features: Tensor, lattice: VoxelLattice, frames: int) -> SparseVoxels:
    """The mean of `features` (P, C) of all points in a voxel; points outside the lattice are left out.

    OpenOccupancy's `HardSimpleVFE` means the first ten of a voxel, of at most 120,000 voxels.
    """
    place, is_inside = lattice.indices_of(points.features[:, :3])
    keys = keys_of(torch.cat([points.frame[:, None], place], dim=1)[is_inside], lattice.shape)
    unique, voxel = torch.unique(keys, return_inverse=True)
    sums = features.new_zeros(len(unique), features.shape[1]).index_add(0, voxel, features[is_inside])
    counts = torch.bincount(voxel, minlength=len(unique))
    return SparseVoxels(sums / counts[:, None], unique, lattice.shape, frames)
