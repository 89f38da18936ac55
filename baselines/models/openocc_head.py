"""OpenOccupancy's head: levels of a pyramid, mixed per voxel with learned weights, to classes of coarse cells.

Source: `occ_plugin/occupancy/dense_heads/occ_head.py`, `OccHead.forward_coarse_voxel` with `soft_weights`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from baselines.layers.fpn3d import normed_convolution3d, resized


@dataclass(frozen=True, eq=False)
class CoarseVolume:
    """Features (B, C, x, y, z) of coarse cells, and their logits (B, 4, x, y, z)."""

    features: Tensor
    logits: Tensor


class SoftWeightedHead(nn.Module):
    """Volumes of `channels`, finest first, to a sum of half as many channels, and from it to logits."""

    def __init__(self, levels: int, channels: int, classes: int) -> None:
        super().__init__()
        hidden = channels // 2
        self.levels = nn.ModuleList(normed_convolution3d(channels, hidden, 3) for _ in range(levels))
        self.level_weights = pointwise_classifier(hidden, levels)
        self.classifier = pointwise_classifier(hidden, classes)

    def forward(self, volumes: Sequence[Tensor]) -> CoarseVolume:
        levels = [layer(volume) for layer, volume in zip(self.levels, volumes, strict=True)]
        weights = self.level_weights(levels[0]).softmax(dim=1)
        mixed = torch.zeros_like(levels[0])
        for i, level in enumerate(levels):
            mixed = mixed + resized(level, levels[0]) * weights[:, i : i + 1]
        return CoarseVolume(mixed, self.classifier(mixed))


def pointwise_classifier(channels: int, classes: int) -> nn.Sequential:
    return nn.Sequential(
        normed_convolution3d(channels, channels // 2, 1), nn.Conv3d(channels // 2, classes, 1, bias=False)
    )
