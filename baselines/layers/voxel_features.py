"""Voxel feature encoding: a learned feature of the points in a voxel (VoxelNet).

**Conventions.** A point's numbers are its own, its offset from the mean of its voxel's points and from its voxel's
centre, in voxels. Points outside the lattice are left out. Empty voxels are 0. Computed in float32 outside autocast.
Source: Zhou and Tuzel, VoxelNet, CVPR 2018, section 2.1.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import Points
from baselines.lattice import VoxelLattice

OFFSETS = 6  # from the voxel's mean and from its centre


class PointNorm(nn.BatchNorm1d):
    """Batch norm over points; fewer than two have no variance and use the running variance."""

    def forward(self, input: Tensor) -> Tensor:
        if len(input) > 1:
            return super().forward(input)
        return functional.batch_norm(
            input, self.running_mean, self.running_var, self.weight, self.bias, training=False, eps=self.eps
        )


def voxel_maxima(values: Tensor, voxel: Tensor, voxels: int) -> Tensor:
    """Return the maximum (V, C) over the rows of `values` (P, C) with that `voxel` (P,); every voxel has a point."""
    into = values.new_zeros(voxels, values.shape[1])
    return into.scatter_reduce(0, voxel[:, None].expand_as(values), values, "amax", include_self=False)


def voxel_means(values: Tensor, voxel: Tensor, voxels: int) -> Tensor:
    """Return the mean (V, C) over the rows of `values` (P, C) with that `voxel` (P,)."""
    counts = values.new_zeros(voxels).index_add(0, voxel, values.new_ones(len(voxel)))
    return values.new_zeros(voxels, values.shape[1]).index_add(0, voxel, values) / counts[:, None].clamp(min=1)


class VoxelFeatureEncoder(nn.Module):
    """Points to a dense volume (B, widths[-1], X, Y, Z) of `lattice`.

    Each layer but the last returns a point's own features with its voxel's maximum; the last only the maximum.
    """

    def __init__(self, point_features: int, widths: tuple[int, ...], lattice: VoxelLattice) -> None:
        super().__init__()
        self.lattice = lattice
        inputs = (point_features + OFFSETS, *(2 * width for width in widths[:-1]))
        self.layers = nn.ModuleList(
            nn.Sequential(nn.Linear(n, width, bias=False), PointNorm(width), nn.ReLU(inplace=True))
            for n, width in zip(inputs, widths, strict=True)
        )
        self.channels = widths[-1]

    def forward(self, points: Points, frames: int) -> Tensor:
        with torch.autocast(points.features.device.type, enabled=False):
            indices, is_inside = self.lattice.indices_of(points.features[:, :3])
            indices, features, frame = indices[is_inside], points.features[is_inside], points.frame[is_inside]
            flat = self._flat(indices, frame)
            places, voxel = torch.unique(flat, return_inverse=True)
            encoded = self._encoded(self._described(features, indices, voxel, len(places)), voxel, len(places))
            dense = encoded.new_zeros(frames * self.lattice.voxels(), self.channels).index_copy(0, places, encoded)
        return dense.reshape(frames, *self.lattice.shape, self.channels).permute(0, 4, 1, 2, 3)

    def _flat(self, indices: Tensor, frame: Tensor) -> Tensor:
        x, y, z = self.lattice.shape
        return ((frame * x + indices[:, 0]) * y + indices[:, 1]) * z + indices[:, 2]

    def _described(self, features: Tensor, indices: Tensor, voxel: Tensor, voxels: int) -> Tensor:
        low, size = features.new_tensor(self.lattice.min_m), features.new_tensor(self.lattice.voxel_m)
        position = (features[:, :3] - low) / size
        from_mean = position - voxel_means(position, voxel, voxels)[voxel]
        from_centre = position - indices.to(position.dtype) - 0.5
        return torch.cat([features, from_mean, from_centre], dim=1)

    def _encoded(self, values: Tensor, voxel: Tensor, voxels: int) -> Tensor:
        for layer in self.layers[:-1]:
            own = layer(values)
            values = torch.cat([own, voxel_maxima(own, voxel, voxels)[voxel]], dim=1)
        return voxel_maxima(self.layers[-1](values), voxel, voxels)


class PointVolumes(nn.Module):
    """VoxelNet's encoder and convolutions: points to volumes at scales, each half as fine as the one before.

    `channels` are the volumes' channels, finest first; `lattice` is the finest volume's.
    """

    def __init__(
        self, point_features: int, widths: tuple[int, ...], channels: tuple[int, ...], lattice: VoxelLattice
    ) -> None:
        super().__init__()
        self.encoder = VoxelFeatureEncoder(point_features, widths, lattice)
        steps = pairwise((widths[-1], *channels))
        self.convolutions = nn.ModuleList(
            nn.Sequential(
                nn.Conv3d(inputs, outputs, 3, stride=1 if step == 0 else 2, padding=1, bias=False),
                nn.BatchNorm3d(outputs),
                nn.ReLU(inplace=True),
            )
            for step, (inputs, outputs) in enumerate(steps)
        )

    def forward(self, points: Points, frames: int) -> list[Tensor]:
        volume: Tensor = self.encoder(points, frames)
        volumes = []
        for convolution in self.convolutions:
            volume = convolution(volume)
            volumes.append(volume)
        return volumes
