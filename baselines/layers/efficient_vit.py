"""EfficientViT's block: attention over a whole map at linear cost, then an inverted residual for what is local.

ReLU attention, `out = ReLU(q) (ReLU(k)ᵀ v) / (ReLU(q) Σ ReLU(k))`, sums over keys once for all queries. Tokens of
several neighbourhoods come from small depthwise convolutions of queries, keys and values.
Source: Cai et al., EfficientViT: Multi-Scale Linear Attention for High-Resolution Dense Prediction, ICCV 2023,
section 3; mit-han-lab/efficientvit, efficientvit/models/nn/ops.py (layers and widths).
"""

import torch
from torch import Tensor, nn

EPSILON = 1e-15


def relu_attention(queries: Tensor, keys: Tensor, values: Tensor) -> Tensor:
    """Normalised linear attention (…, d, L) of queries, keys and values (…, d, L) over all L tokens, in float32."""
    with torch.autocast(queries.device.type, enabled=False):
        queries, keys, values = queries.float().relu(), keys.float().relu(), values.float()
        summary = values @ keys.transpose(-1, -2)
        weight = keys.sum(dim=-1, keepdim=True).transpose(-1, -2) @ queries
        # Not `+ EPSILON`: what optimises exported graphs takes that for 0, and divides 0 by 0.
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
    """Context over the whole map (B, C, H, W), then local detail, each added to what came in."""

    def __init__(self, channels: int, head_channels: int) -> None:
        super().__init__()
        self.context = MultiScaleLinearAttention(channels, head_channels)
        self.local = InvertedResidual(channels)

    def forward(self, features: Tensor) -> Tensor:
        features = features + self.context(features)
        mixed: Tensor = features + self.local(features)
        return mixed
