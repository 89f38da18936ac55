"""Convolutions (3 × 3 × 3) that compute at occupied voxels only: gather, multiply by the offset's matrix, add up.

**Conventions.** A `Rulebook` says for each of the 27 offsets, in the order of a dense kernel, which input voxel adds to
which output voxel. Weights are (27, C_in, C_out); `dense_weight` shows them as `conv3d` takes them. Sources: Graham et
al., 3D semantic segmentation with submanifold sparse convolutional networks, CVPR 2018; spconv's `SubMConv3d` and
`SparseConv3d`.
"""

from dataclasses import dataclass
from math import sqrt

import torch
from torch import Tensor, nn

from baselines.lattice import Shape
from baselines.layers.sparse_voxels import SparseVoxels, indices_of, keys_of

OFFSETS = 27
CENTRE = 13


@dataclass(frozen=True, eq=False)
class Rulebook:
    """For each offset the positions of inputs and outputs (n,) int64 that it joins; the outputs' keys and lattice."""

    pairs: tuple[tuple[Tensor, Tensor], ...]
    keys: Tensor
    shape: Shape


def submanifold_rules(voxels: SparseVoxels) -> Rulebook:
    """Outputs are where inputs are: output p takes input p + offset, of offsets −1, 0, 1 along each axis."""
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
    """Stride 2, padding 1: output p takes inputs 2 p − 1 + k, k in 0 … 2, and is wherever it takes one."""
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
    """A convolution along a rulebook: without a bias, unless asked for."""

    def __init__(self, channels_in: int, channels_out: int, bias: bool = False) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(OFFSETS, channels_in, channels_out))
        self.bias = nn.Parameter(torch.zeros(channels_out)) if bias else None
        nn.init.normal_(self.weight, std=sqrt(2 / (OFFSETS * channels_in)))

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> SparseVoxels:
        """Sums are taken in float32 at least, also where autocast multiplies in bfloat16."""
        wide = torch.promote_types(voxels.features.dtype, torch.float32)
        sums = voxels.features.new_zeros(len(rules.keys), self.weight.shape[2], dtype=wide)
        for (inputs, outputs), matrix in zip(rules.pairs, self.weight, strict=True):
            sums.index_add_(0, outputs, (voxels.features[inputs] @ matrix).to(wide))
        if self.bias is not None:
            sums = sums + self.bias
        return SparseVoxels(sums, rules.keys, rules.shape, voxels.frames)

    def dense_weight(self) -> Tensor:
        """(C_out, C_in, 3, 3, 3)."""
        return self.weight.permute(2, 1, 0).reshape(-1, self.weight.shape[1], 3, 3, 3)


def kernel_offsets(device: torch.device) -> Tensor:
    """(27, 3) int64 of 0 … 2, the last axis fastest."""
    return indices_of(torch.arange(OFFSETS, device=device), (3, 3, 3))[:, 1:]


def positions_of(wanted: Tensor, keys: Tensor) -> tuple[Tensor, Tensor]:
    """Where `wanted` stand in ascending `keys`, and which of them do; the others' position is any valid one."""
    place = torch.searchsorted(keys, wanted).clamp(max=max(len(keys) - 1, 0))
    return place, keys[place] == wanted if len(keys) else torch.zeros_like(wanted, dtype=torch.bool)


def is_inside(indices: Tensor, shape: Shape) -> Tensor:
    """Which indices (V, 4) lie in a lattice of `shape`."""
    place = indices[:, 1:]
    return ((place >= 0) & (place < place.new_tensor(shape))).all(dim=1)


def halved(shape: Shape) -> Shape:
    """The shape after a stride of 2, rounded up."""
    x, y, z = ((n + 1) // 2 for n in shape)
    return x, y, z
