"""EfficientViT's block: attention over a whole map at linear cost, then an inverted residual for local detail.

ReLU attention, `out = ReLU(q) (ReLU(k)ᵀ v) / (ReLU(q) Σ ReLU(k))`, sums over keys once for all queries. Tokens of
several neighbourhoods come from small depthwise convolutions of queries, keys and values. Source: Cai et al.,
EfficientViT: Multi-Scale Linear Attention for High-Resolution Dense Prediction, ICCV 2023, section 3;
mit-han-lab/efficientvit, efficientvit/models/nn/ops.py (layers and widths).
"""

import torch
from torch import Tensor, nn

from baselines.layers.sensor_fusion import unit2d, unit3d

EPSILON = 1e-15


def relu_attention(queries: Tensor, keys: Tensor, values: Tensor) -> Tensor:
    """Return normalised linear attention (…, d, L) of queries, keys and values (…, d, L) over L tokens, in float32."""
    with torch.autocast(queries.device.type, enabled=False):
        queries, keys, values = queries.float().relu(), keys.float().relu(), values.float()
        summary = values @ keys.transpose(-1, -2)
        weight = keys.sum(dim=-1, keepdim=True).transpose(-1, -2) @ queries
        # Not `+ EPSILON`: optimisers of exported graphs replace it by 0 and divide 0 by 0.
        return summary @ queries / weight.clamp(min=EPSILON)


class MultiScaleLinearAttention(nn.Module):
    """ReLU attention of a map (B, C, H, W) in heads of `head_channels`, of single tokens and of each of `kernels`."""

    def __init__(self, channels: int, head_channels: int, kernels: tuple[int, ...] = (5,)) -> None:
        super().__init__()
        self.head_channels = head_channels
        width = channels // head_channels * head_channels
        self.qkv = nn.Conv2d(channels, 3 * width, 1, bias=False)
        groups = 3 * width // head_channels
        self.aggregations = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(3 * width, 3 * width, kernel, padding=kernel // 2, groups=3 * width, bias=False),
                nn.Conv2d(3 * width, 3 * width, 1, groups=groups, bias=False),
            )
            for kernel in kernels
        )
        self.project = nn.Sequential(
            nn.Conv2d(width * (1 + len(kernels)), channels, 1, bias=False), nn.BatchNorm2d(channels)
        )

    def forward(self, features: Tensor) -> Tensor:
        tokens = self.qkv(features)
        scales = torch.cat([tokens, *(aggregate(tokens) for aggregate in self.aggregations)], dim=1)
        batch, _, height, width = scales.shape
        heads = scales.reshape(batch, -1, 3 * self.head_channels, height * width)
        attended = relu_attention(*heads.chunk(3, dim=2))
        projected: Tensor = self.project(attended.reshape(batch, -1, height, width).to(features.dtype))
        return projected


class InvertedResidual(nn.Module):
    """Widen by `expansion`, convolve each channel 3 × 3, narrow again (MobileNetV2, with hard swish)."""

    def __init__(self, channels: int, expansion: int = 4) -> None:
        super().__init__()
        width = channels * expansion
        self.layers = nn.Sequential(
            nn.Conv2d(channels, width, 1),
            nn.Hardswish(),
            nn.Conv2d(width, width, 3, padding=1, groups=width),
            nn.Hardswish(),
            nn.Conv2d(width, channels, 1, bias=False),
            nn.BatchNorm2d(channels),
        )

    def forward(self, features: Tensor) -> Tensor:
        convolved: Tensor = self.layers(features)
        return convolved


class EfficientViTBlock(nn.Module):
    """Context over the whole map (B, C, H, W), then local detail, each added to its input."""

    def __init__(self, channels: int, head_channels: int) -> None:
        super().__init__()
        self.context = MultiScaleLinearAttention(channels, head_channels)
        self.local = InvertedResidual(channels)

    def forward(self, features: Tensor) -> Tensor:
        features = features + self.context(features)
        mixed: Tensor = features + self.local(features)
        return mixed


# Fusion of global and local features: a map of the whole scene, attended and atrous, weighted into a volume. Source:
# Ming et al., OccFusion, IEEE T-IV 2024, and InverseMatrixVT3D, IROS 2024 (global-local attention fusion); the atrous
# pyramid: Chen et al., DeepLabv3, 2017.


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
        # No norm on the mean: one number per channel has no variance in a batch of one frame.
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
