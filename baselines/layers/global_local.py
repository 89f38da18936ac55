"""Global and local features made one: a map of the whole scene, attended and atrous, weighed into a volume.

Source: Ming et al., OccFusion, IEEE T-IV 2024, and InverseMatrixVT3D, IROS 2024 (global-local attention fusion); the
atrous pyramid: Chen et al., DeepLabv3, 2017.
"""

import torch
from torch import Tensor, nn

from baselines.layers.efficient_vit import EfficientViTBlock
from baselines.layers.sensor_fusion import unit2d, unit3d


class MapContext(nn.Module):
    """Atrous spatial pyramid of a map (B, C, H, W): 1 × 1, 3 × 3 at each rate, and the map's mean, projected to C."""

    def __init__(self, channels: int, rates: tuple[int, ...]) -> None:
        super().__init__()
        self.point = unit2d(channels, channels, 1)
        self.atrous = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(channels, channels, 3, padding=rate, dilation=rate, bias=False),
                nn.BatchNorm2d(channels),
                nn.ReLU(inplace=True),
            )
            for rate in rates
        )
        # No norm on the mean: one number a channel has no variance when a batch is one frame.
        self.mean = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(channels, channels, 1), nn.ReLU(inplace=True))
        self.project = unit2d(channels * (2 + len(rates)), channels, 1)

    def forward(self, features: Tensor) -> Tensor:
        mean = self.mean(features).expand_as(features)
        parts = [self.point(features), *(branch(features) for branch in self.atrous), mean]
        projected: Tensor = self.project(torch.cat(parts, dim=1))
        return projected


class GlobalLocalFusion(nn.Module):
    """A volume (B, C, X, Y, Z) and its map (B, C, X, Y) to a volume: `local + σ(w) global`, w of both."""

    def __init__(self, channels: int, head_channels: int, rates: tuple[int, ...]) -> None:
        super().__init__()
        self.of_map = nn.Sequential(
            unit2d(channels, channels, 3),
            EfficientViTBlock(channels, head_channels),
            MapContext(channels, rates),
            unit2d(channels, channels, 3),
        )
        self.of_volume = nn.Sequential(
            unit3d(channels, channels, 3),
            nn.Conv3d(channels, channels, 3, padding=1, bias=False),
            nn.BatchNorm3d(channels),
        )
        self.weigh = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, volume: Tensor, bev: Tensor) -> Tensor:
        local = torch.relu(volume + self.of_volume(volume))
        whole = self.of_map(bev)[..., None]
        fused: Tensor = local + self.weigh(local + whole).sigmoid() * whole
        return fused
