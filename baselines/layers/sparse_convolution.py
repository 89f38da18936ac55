"""Convolutions (3 × 3 × 3) at occupied voxels only: gather, multiply by the offset's matrix, add.

**Conventions.** For each of the 27 offsets, in the order of a dense kernel, a `Rulebook` lists which input voxel adds
to which output voxel. Weights are (27, C_in, C_out); `dense_weight` returns them in the layout of `conv3d`. Sources:
Graham et al., 3D semantic segmentation with submanifold sparse convolutional networks, CVPR 2018; spconv's `SubMConv3d`
and `SparseConv3d`.
"""

from dataclasses import dataclass, replace
from math import sqrt

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import Points
from baselines.lattice import Shape, VoxelLattice

# Features of the occupied voxels only, in the order of their keys. A voxel's key is `((frame · X + x) · Y + y) · Z +
# z`, int64; keys are ascending and unique.


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
        """Return (V, 4) int64: frame, x, y, z."""
        return indices_of(self.keys, self.shape)

    def dense(self) -> Tensor:
        """Return (B, C, X, Y, Z), 0 at empty voxels."""
        x, y, z = self.shape
        volume = self.features.new_zeros(self.frames * x * y * z, self.features.shape[1])
        volume = volume.index_copy(0, self.keys, self.features)
        return volume.view(self.frames, x, y, z, -1).permute(0, 4, 1, 2, 3).contiguous()


def keys_of(indices: Tensor, shape: Shape) -> Tensor:
    """Return the keys (V,) of indices (V, 4)."""
    x, y, z = shape
    return ((indices[:, 0] * x + indices[:, 1]) * y + indices[:, 2]) * z + indices[:, 3]


def indices_of(keys: Tensor, shape: Shape) -> Tensor:
    """Return the indices (V, 4) of keys (V,)."""
    x, y, z = shape
    return torch.stack([keys // (x * y * z), keys // (y * z) % x, keys // z % y, keys % z], dim=1)


def means_of_points(points: Points, features: Tensor, lattice: VoxelLattice, frames: int) -> SparseVoxels:
    """Return the mean of `features` (P, C) of all points in a voxel; points outside the lattice are left out.

    OpenOccupancy's `HardSimpleVFE` averages the first ten points of a voxel, of at most 120,000 voxels.
    """
    voxel_index, is_inside = lattice.indices_of(points.features[:, :3])
    keys = keys_of(torch.cat([points.frame[:, None], voxel_index], dim=1)[is_inside], lattice.shape)
    unique, voxel = torch.unique(keys, return_inverse=True)
    sums = features.new_zeros(len(unique), features.shape[1]).index_add(0, voxel, features[is_inside])
    counts = torch.bincount(voxel, minlength=len(unique))
    return SparseVoxels(sums / counts[:, None], unique, lattice.shape, frames)


OFFSETS = 27
CENTRE = 13


@dataclass(frozen=True, eq=False)
class Rulebook:
    """The input and output positions (n,) int64 of each offset, and the outputs' keys and lattice."""

    pairs: tuple[tuple[Tensor, Tensor], ...]
    keys: Tensor
    shape: Shape


def submanifold_rules(voxels: SparseVoxels) -> Rulebook:
    """Return rules with outputs at the inputs: output p takes input p + offset, of offsets −1, 0, 1 along each axis."""
    indices = voxels.indices()
    everyone = torch.arange(len(indices), device=indices.device)
    pairs: list[tuple[Tensor, Tensor]] = []
    for offset in kernel_offsets(indices.device)[:CENTRE] - 1:
        there = indices + torch.cat([offset.new_zeros(1), offset])
        inputs, is_found = positions_of(keys_of(there, voxels.shape), voxels.keys)
        is_found &= is_inside(there, voxels.shape)
        pairs.append((inputs[is_found], everyone[is_found]))
    mirrored = [(outputs, inputs) for inputs, outputs in reversed(pairs)]
    return Rulebook((*pairs, (everyone, everyone), *mirrored), voxels.keys, voxels.shape)


def strided_rules(voxels: SparseVoxels) -> Rulebook:
    """Return rules of stride 2, padding 1: output p takes inputs 2 p − 1 + k, k in 0 … 2, and exists if any does."""
    shape = halved(voxels.shape)
    indices = voxels.indices()
    everyone = torch.arange(len(indices), device=indices.device)
    joined: list[tuple[Tensor, Tensor]] = []
    for offset in kernel_offsets(indices.device):
        doubled = indices[:, 1:] + 1 - offset
        there = torch.cat([indices[:, :1], doubled.div(2, rounding_mode="floor")], dim=1)
        is_output = (doubled % 2 == 0).all(dim=1) & is_inside(there, shape)
        joined.append((everyone[is_output], keys_of(there[is_output], shape)))
    keys = torch.unique(torch.cat([outputs for _, outputs in joined]))
    pairs = tuple((inputs, torch.searchsorted(keys, outputs)) for inputs, outputs in joined)
    return Rulebook(pairs, keys, shape)


class SparseConvolution3d(nn.Module):
    """A convolution along a rulebook, by default without a bias."""

    def __init__(self, channels_in: int, channels_out: int, bias: bool = False) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(OFFSETS, channels_in, channels_out))
        self.bias = nn.Parameter(torch.zeros(channels_out)) if bias else None
        nn.init.normal_(self.weight, std=sqrt(2 / (OFFSETS * channels_in)))

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> SparseVoxels:
        """Return the convolved voxels; sums are at least float32, even if autocast multiplies in bfloat16."""
        wide = torch.promote_types(voxels.features.dtype, torch.float32)
        sums = voxels.features.new_zeros(len(rules.keys), self.weight.shape[2], dtype=wide)
        for (inputs, outputs), matrix in zip(rules.pairs, self.weight, strict=True):
            sums.index_add_(0, outputs, (voxels.features[inputs] @ matrix).to(wide))
        if self.bias is not None:
            sums = sums + self.bias
        return SparseVoxels(sums, rules.keys, rules.shape, voxels.frames)

    def dense_weight(self) -> Tensor:
        """Return the weights as (C_out, C_in, 3, 3, 3)."""
        return self.weight.permute(2, 1, 0).reshape(-1, self.weight.shape[1], 3, 3, 3)


def kernel_offsets(device: torch.device) -> Tensor:
    """Return (27, 3) int64 of 0 … 2, the last axis fastest."""
    return indices_of(torch.arange(OFFSETS, device=device), (3, 3, 3))[:, 1:]


def positions_of(wanted: Tensor, keys: Tensor) -> tuple[Tensor, Tensor]:
    """Return the positions of `wanted` in ascending `keys`, and which exist; other positions are any valid index."""
    position = torch.searchsorted(keys, wanted).clamp(max=max(len(keys) - 1, 0))
    return position, keys[position] == wanted if len(keys) else torch.zeros_like(wanted, dtype=torch.bool)


def is_inside(indices: Tensor, shape: Shape) -> Tensor:
    """Return which indices (V, 4) are in a lattice of `shape`."""
    voxel = indices[:, 1:]
    return ((voxel >= 0) & (voxel < voxel.new_tensor(shape))).all(dim=1)


def halved(shape: Shape) -> Shape:
    """Return the shape after a stride of 2, rounded up."""
    x, y, z = ((n + 1) // 2 for n in shape)
    return x, y, z


# Sparse encoder of LiDAR: from means of points in voxels to a dense volume 4 or 8 times coarser. Source:
# OpenOccupancy's `occ_plugin/occupancy/voxel_encoder/sparse_lidar_enc.py`, `SparseLiDAREnc8x` and `4x`. The official
# code has `GroupNorm(16, 16)` after the first convolution, on rows of 16 numbers. Each number is a group, so all become
# the bias and the encoder sees only which voxels are occupied. Here both such norms are batch norms, like all others,
# with as many parameters.


STAGES = 3


class NormedSparseConvolution(nn.Module):
    """A sparse convolution, batch norm over occupied voxels, ReLU."""

    def __init__(self, channels_in: int, channels_out: int, bias: bool = False) -> None:
        super().__init__()
        self.convolution = SparseConvolution3d(channels_in, channels_out, bias)
        self.norm = nn.BatchNorm1d(channels_out)

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> SparseVoxels:
        convolved: SparseVoxels = self.convolution(voxels, rules)
        return convolved.with_features(functional.relu(self.norm(convolved.features)))


class SparseResidualBlock(nn.Module):
    """Two convolutions with a residual connection."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = NormedSparseConvolution(channels, channels)
        self.second = SparseConvolution3d(channels, channels)
        self.norm = nn.BatchNorm1d(channels)

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> SparseVoxels:
        convolved: SparseVoxels = self.second(self.first(voxels, rules), rules)
        return convolved.with_features(functional.relu(self.norm(convolved.features) + voxels.features))


class SparseStage(nn.Module):
    """A strided convolution if channels grow, and two residual blocks."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.down = NormedSparseConvolution(channels_in, channels_out) if channels_in != channels_out else None
        self.blocks = nn.ModuleList(SparseResidualBlock(channels_out) for _ in range(2))

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> tuple[SparseVoxels, Rulebook]:
        """Return the stage's voxels, and the rules of submanifold convolutions on them."""
        if self.down is not None:
            voxels = self.down(voxels, strided_rules(voxels))
            rules = submanifold_rules(voxels)
        for block in self.blocks:
            voxels = block(voxels, rules)
        return voxels, rules


class SparseEncoder(nn.Module):
    """Three stages: 16 channels at first, doubled by each stage that halves the lattice (all 3, or the last 2).

    `ratio` is 8 or 4; another value raises `ValueError`. With ratio 8, 4 features, 16 and 80 channels it has 2,893,472
    parameters.
    """

    def __init__(self, features: int, channels: int, channels_out: int, ratio: int) -> None:
        super().__init__()
        if ratio not in (4, 8):
            raise ValueError(f"a sparse encoder makes voxels 4 or 8 times coarser, not {ratio} times")
        growth = (2, 4, 8) if ratio == 8 else (1, 2, 4)
        widths = [channels, *(channels * times for times in growth)]
        self.first = NormedSparseConvolution(features, channels, bias=True)
        self.stages = nn.ModuleList(SparseStage(widths[i], widths[i + 1]) for i in range(STAGES))
        self.last = NormedSparseConvolution(widths[-1], channels_out, bias=True)

    def forward(self, voxels: SparseVoxels) -> Tensor:
        """Return (B, channels_out, X / ratio, Y / ratio, Z / ratio), 0 at empty voxels."""
        rules = submanifold_rules(voxels)
        voxels = self.first(voxels, rules)
        for stage in self.stages:
            voxels, rules = stage(voxels, rules)
        encoded: SparseVoxels = self.last(voxels, rules)
        return encoded.dense()
