"""A U-Net over a map of columns: residual blocks at each scale, attention over the whole map at the coarsest."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.layers.column_cameras import halving
from baselines.layers.depth_network import ResidualBlock2d
from baselines.layers.efficient_vit import EfficientViTBlock
from baselines.layers.sensor_fusion import unit2d


class ColumnUNet(nn.Module):
    """A map (B, widths[0], X, Y) to one of the same shape; scale i has `widths[i]` channels and `depths[i]` blocks.

    X and Y are multiples of 2 ** (scales − 1).
    """

    def __init__(self, widths: tuple[int, ...], depths: tuple[int, ...], head_channels: int) -> None:
        super().__init__()
        self.descent = nn.ModuleList(residuals(width, depth) for width, depth in zip(widths, depths, strict=True))
        self.halvings = nn.ModuleList(halving(fine, coarse) for fine, coarse in pairwise(widths))
        self.context = EfficientViTBlock(widths[-1], head_channels)
        self.narrowings = nn.ModuleList(unit2d(coarse, fine, 1) for fine, coarse in pairwise(widths))
        self.ascent = nn.ModuleList(residuals(width, 1) for width in widths[:-1])

    def forward(self, features: Tensor) -> Tensor:
        skips = []
        for blocks, halve in zip(self.descent[:-1], self.halvings, strict=True):
            skips.append(blocks(features))
            features = halve(skips[-1])
        features = self.context(self.descent[-1](features))
        for skip, narrow, blocks in zip(reversed(skips), reversed(self.narrowings), reversed(self.ascent), strict=True):
            coarse = functional.interpolate(narrow(features), scale_factor=2.0, mode="bilinear")
            features = blocks(torch.relu(skip + coarse))
        return features


def residuals(width: int, depth: int) -> nn.Sequential:
    return nn.Sequential(*(ResidualBlock2d(width) for _ in range(depth)))
