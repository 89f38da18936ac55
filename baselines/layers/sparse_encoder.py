"""Sparse encoder of LiDAR: from means of points in voxels to a dense volume 4 or 8 times coarser.

Source: OpenOccupancy's `occ_plugin/occupancy/voxel_encoder/sparse_lidar_enc.py`, `SparseLiDAREnc8x` and `4x`. It puts
`GroupNorm(16, 16)` behind the first convolution, on rows of 16 numbers: each is a group by itself, so all become the
bias and the encoder sees where voxels are and nothing of their points. Here both norms that are written so are batch
norms, like all others of it, with as many parameters.
"""

from torch import Tensor, nn
from torch.nn import functional

from baselines.layers.sparse_convolution import Rulebook, SparseConvolution3d, strided_rules, submanifold_rules
from baselines.layers.sparse_voxels import SparseVoxels

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
    """Two convolutions around which features are added."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = NormedSparseConvolution(channels, channels)
        self.second = SparseConvolution3d(channels, channels)
        self.norm = nn.BatchNorm1d(channels)

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> SparseVoxels:
        convolved: SparseVoxels = self.second(self.first(voxels, rules), rules)
        return convolved.with_features(functional.relu(self.norm(convolved.features) + voxels.features))


class SparseStage(nn.Module):
    """A strided convolution where channels grow, and two residual blocks."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.down = NormedSparseConvolution(channels_in, channels_out) if channels_in != channels_out else None
        self.blocks = nn.ModuleList(SparseResidualBlock(channels_out) for _ in range(2))

    def forward(self, voxels: SparseVoxels, rules: Rulebook) -> tuple[SparseVoxels, Rulebook]:
        """The stage's voxels, and the rules of submanifold convolutions on them."""
        if self.down is not None:
            voxels = self.down(voxels, strided_rules(voxels))
            rules = submanifold_rules(voxels)
        for block in self.blocks:
            voxels = block(voxels, rules)
        return voxels, rules


class SparseEncoder(nn.Module):
    """Three stages: 16 channels at first, doubled by each stage that halves the lattice (all 3, or the last 2).

    `ratio` is 8 or 4; another raises `ValueError`. Of 4 features, 16 and 80 channels 2,893,472 parameters with 8.
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
        """(B, channels_out, X / ratio, Y / ratio, Z / ratio), 0 where no voxel is."""
        rules = submanifold_rules(voxels)
        voxels = self.first(voxels, rules)
        for stage in self.stages:
            voxels, rules = stage(voxels, rules)
        encoded: SparseVoxels = self.last(voxels, rules)
        return encoded.dense()
