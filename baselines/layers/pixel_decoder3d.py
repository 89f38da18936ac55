"""Mask2Former's pixel decoder in three dimensions: brings all levels to one width and exchanges features between them.

**Conventions.** Levels are (B, C, X, Y, Z), the finest first, each half as fine as the one before. The finest level
takes no part in attention: it is added to the resampled next level, and masks are products with the result.

Source: Cheng et al., Mask2Former, CVPR 2022, section 3.2.1; Zhang et al., OccFormer, ICCV 2023, section 3.3;
zhangyp15/OccFormer, necks/multiscale_deformattn_3d.py.
"""

from dataclasses import dataclass, field
from math import tau

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate
from torch.utils.checkpoint import checkpoint

from baselines.lattice import Shape
from baselines.layers.deformable_attention3d import DeformableAttention3D, DeformableSettings3D, voxel_places
from baselines.layers.dual_path import group_norm

Levels = tuple[Tensor, ...]


@dataclass(frozen=True)
class PixelDecoderSettings:
    """`inputs`: channels of each level, the finest first; `attention.levels` of them, the coarsest, attend."""

    inputs: tuple[int, ...] = (128, 256, 512, 1024)
    attention: DeformableSettings3D = field(default_factory=DeformableSettings3D)
    layers: int = 6
    hidden: int = 768  # within the feed-forward networks
    checkpoint_gradients: bool = False


class PixelDecoder3D(nn.Module):
    """Levels of a 3D encoder → features of masks on the finest level, and memories, the coarsest first."""

    def __init__(self, settings: PixelDecoderSettings) -> None:
        super().__init__()
        finest, *coarser = settings.inputs
        channels = settings.attention.channels
        if len(coarser) != settings.attention.levels:
            raise ValueError(f"{len(coarser)} coarser levels, but attention over {settings.attention.levels}")
        self.checkpoint_gradients = settings.checkpoint_gradients
        self.inputs = nn.ModuleList(
            nn.Sequential(nn.Conv3d(width, channels, 1), group_norm(channels)) for width in reversed(coarser)
        )
        self.level = nn.Embedding(len(coarser), channels)
        self.layers = nn.ModuleList(PixelDecoderLayer(settings) for _ in range(settings.layers))
        self.lateral = nn.Sequential(nn.Conv3d(finest, channels, 1, bias=False), group_norm(channels))
        self.output = nn.Sequential(
            nn.Conv3d(channels, channels, 3, padding=1, bias=False), group_norm(channels), nn.ReLU(inplace=True)
        )
        self.mask_features = nn.Conv3d(channels, channels, 1)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        for module in self.modules():
            if isinstance(module, nn.Conv3d):
                nn.init.kaiming_uniform_(module.weight, a=1.0)  # Caffe's "xavier"
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        for projection in self.inputs.modules():
            if isinstance(projection, nn.Conv3d):
                nn.init.xavier_uniform_(projection.weight)

    def forward(self, levels: Levels) -> tuple[Tensor, Levels]:
        coarser = [project(level) for project, level in zip(self.inputs, reversed(levels[1:]), strict=True)]
        shapes = tuple(shape_of(level) for level in coarser)
        tokens = torch.cat([level.flatten(2).transpose(1, 2) for level in coarser], dim=1)
        positions, places = self._positions(shapes, tokens), voxel_places(shapes, tokens.device)
        for layer in self.layers:
            if self.checkpoint_gradients and self.training:
                tokens = checkpoint(layer, tokens, positions, places, shapes, use_reentrant=False)
            else:
                tokens = layer(tokens, positions, places, shapes)
        memories = tuple(
            part.transpose(1, 2).reshape(len(part), -1, *shape)
            for part, shape in zip(torch.split(tokens, [x * y * z for x, y, z in shapes], dim=1), shapes, strict=True)
        )
        finer = interpolate(memories[-1], size=levels[0].shape[2:], mode="trilinear", align_corners=False)
        return self.mask_features(self.output(self.lateral(levels[0]) + finer)), memories

    def _positions(self, shapes: tuple[Shape, ...], tokens: Tensor) -> Tensor:
        sines = [sine_positions(shape, tokens.shape[2], tokens.device) for shape in shapes]
        return torch.cat([sine + self.level.weight[n] for n, sine in enumerate(sines)])


class PixelDecoderLayer(nn.Module):
    """Deformable attention over all levels, then a feed-forward network; each added to its input and normalised."""

    def __init__(self, settings: PixelDecoderSettings) -> None:
        super().__init__()
        channels = settings.attention.channels
        self.attention = DeformableAttention3D(settings.attention)
        self.norm1 = nn.LayerNorm(channels)
        self.feed_forward = nn.Sequential(
            nn.Linear(channels, settings.hidden), nn.ReLU(inplace=True), nn.Linear(settings.hidden, channels)
        )
        self.norm2 = nn.LayerNorm(channels)
        for layer in self.feed_forward:
            if isinstance(layer, nn.Linear):
                nn.init.xavier_normal_(layer.weight)

    def forward(self, tokens: Tensor, positions: Tensor, places: Tensor, shapes: tuple[Shape, ...]) -> Tensor:
        read = self.attention(tokens + positions, places, tokens, shapes)
        tokens = self.norm1(tokens + read)
        answered: Tensor = self.norm2(tokens + self.feed_forward(tokens))
        return answered


def shape_of(volume: Tensor) -> Shape:
    x, y, z = volume.shape[2:]
    return x, y, z


# Positions of a volume's voxels as sines and cosines. Source: Carion et al., DETR, ECCV 2020, in three dimensions:
# zhangyp15/OccFormer, mask2former/positional_encodings (`SinePositionalEncoding3D`, normalised).


TEMPERATURE = 10_000.0
EPSILON = 1e-6


def sine_positions(shape: Shape, channels: int, device: torch.device | None = None) -> Tensor:
    """Return (X·Y·Z, channels) float32: a third of the channels for each axis, whose length is one period of the
    slowest wave.

    `channels` is a multiple of 6: sine and cosine alternate.
    """
    each = channels // 3
    exponent = 2.0 * torch.div(torch.arange(each, device=device), 2, rounding_mode="floor") / each
    axes = []
    for axis, length in enumerate(shape):
        steps = torch.arange(1, length + 1, device=device, dtype=torch.float32)
        phase = (steps / (length + EPSILON) * tau)[:, None] / TEMPERATURE**exponent
        waves = torch.stack((phase[:, 0::2].sin(), phase[:, 1::2].cos()), dim=2).flatten(1)
        axes.append(waves.reshape([length if a == axis else 1 for a in range(3)] + [each]).expand(*shape, each))
    return torch.cat(axes, dim=3).flatten(0, 2)
