"""Fusion of two sensors' features by channel: squeeze and excitation. `visible_fusion.py` gates by voxel.

Source: Ming et al., OccFusion, IEEE T-IV 2024 (dynamic fusion 3D and 2D); Hu et al., Squeeze-and-Excitation Networks,
CVPR 2018.
"""

import torch
from torch import Tensor, nn


def unit3d(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    """Return a convolution that keeps the shape, batch norm, ReLU."""
    convolution = nn.Conv3d(inputs, outputs, kernel, padding=kernel // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm3d(outputs), nn.ReLU(inplace=True))


def unit2d(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    """Return a convolution that keeps the shape, batch norm, ReLU."""
    convolution = nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class ChannelExcitation(nn.Module):
    """Each channel weighted by the mean of all channels over the whole extent (B, C, …)."""

    def __init__(self, channels: int, reduction: int = 16) -> None:
        super().__init__()
        width = max(channels // reduction, 4)
        self.weigh = nn.Sequential(nn.Linear(channels, width), nn.ReLU(), nn.Linear(width, channels), nn.Sigmoid())

    def forward(self, features: Tensor) -> Tensor:
        weights: Tensor = self.weigh(features.flatten(2).mean(dim=2))
        return features * weights.reshape(*weights.shape, *(1,) * (features.ndim - 2))


class DynamicFusion3d(nn.Module):
    """Volumes of two sensors (B, C, X, Y, Z) to one: a residual excited by channel, then merged."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        both = 2 * channels
        self.residual = nn.Sequential(
            unit3d(both, both, 3),
            nn.Conv3d(both, both, 3, padding=1, bias=False),
            nn.BatchNorm3d(both),
            ChannelExcitation(both),
        )
        self.merge = unit3d(both, channels, 3)

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        both = torch.cat([first, second], dim=1)
        merged: Tensor = self.merge(torch.relu(both + self.residual(both)))
        return merged


class DynamicFusion2d(nn.Module):
    """Maps of two sensors (B, C, X, Y) to one: excited by channel, then merged."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(ChannelExcitation(2 * channels), unit2d(2 * channels, channels, 1))

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        merged: Tensor = self.layers(torch.cat([first, second], dim=1))
        return merged
