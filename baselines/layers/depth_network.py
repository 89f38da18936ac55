"""BEVDepth's depth network: depth and context of each cell of a feature map, given its camera.

Source: Li et al., BEVDepth (AAAI 2023); OccFormer's `image2bev/ViewTransformerLSSBEVDepth.py`, the same in
OpenOccupancy, with its first-generation deformable convolution in 4 groups and its numbers of parameters.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import Batch
from baselines.layers.deformable_convolution import DeformableConv2d

CAMERA_NUMBERS = 27
KILOPIXELS = 1e-3  # pixels to kilopixels


@dataclass(frozen=True)
class DepthNetworkConfig:
    """Widths; `mid_channels` is a multiple of 4."""

    in_channels: int = 512
    mid_channels: int = 512
    context_channels: int = 80
    depth_bins: int = 112
    dropout: float = 0.5


def camera_vectors(batch: Batch) -> Tensor:
    """Return the 27 numbers (B, N, 27) of each camera: intrinsics 4, images' augmentation 6, the grid's 5, extrinsics
    12.

    Lengths in images are in thousands of pixels. The official code uses pixels; with equal focal lengths of all
    cameras, running means are then never close enough for the norm's ε. Raises `ValueError` without cameras.
    """
    if batch.cameras is None:
        raise ValueError("this batch has no cameras")
    scale = batch.cameras.intrinsics.new_tensor([KILOPIXELS, KILOPIXELS, 1.0])[:, None]
    k, moved = batch.cameras.intrinsics * scale, batch.cameras.augmented_from_image
    grid = batch.grid_from_ego[:, None].expand(-1, k.shape[1], -1, -1)
    picked = torch.stack(
        [
            *(k[..., 0, 0], k[..., 1, 1], k[..., 0, 2], k[..., 1, 2]),
            *(moved[..., 0, 0], moved[..., 0, 1], moved[..., 0, 2] * KILOPIXELS),
            *(moved[..., 1, 0], moved[..., 1, 1], moved[..., 1, 2] * KILOPIXELS),
            *(grid[..., 0, 0], grid[..., 0, 1], grid[..., 1, 0], grid[..., 1, 1], grid[..., 2, 2]),
        ],
        dim=-1,
    )
    return torch.cat([picked, batch.cameras.ego_from_camera[..., :3, :].flatten(2)], dim=-1)


class DepthNetwork(nn.Module):
    """Features (M, C, h, w) of M images and their cameras' vectors (M, 27) to logits of depth and to context.

    Logits (M, `depth_bins`, h, w), context (M, `context_channels`, h, w).
    """

    def __init__(self, config: DepthNetworkConfig) -> None:
        super().__init__()
        mid = config.mid_channels
        self.reduce = nn.Sequential(
            nn.Conv2d(config.in_channels, mid, 3, padding=1), nn.BatchNorm2d(mid), nn.ReLU(inplace=True)
        )
        self.camera_norm = nn.BatchNorm1d(CAMERA_NUMBERS)
        self.depth_excitation = CameraExcitation(mid)
        self.context_excitation = CameraExcitation(mid)
        self.depth = nn.Sequential(
            *(ResidualBlock2d(mid) for _ in range(3)),
            DilatedPyramid2d(mid, config.dropout),
            DeformableConv2d(mid, mid, groups=4, is_modulated=False),
            nn.Conv2d(mid, config.depth_bins, 1),
        )
        self.context = nn.Conv2d(mid, config.context_channels, 1)

    def forward(self, features: Tensor, cameras: Tensor) -> tuple[Tensor, Tensor]:
        with torch.autocast(features.device.type, enabled=False):  # focal lengths of a thousand pixels
            normalised = self.camera_norm(cameras.float())
        reduced = self.reduce(features)
        depth = self.depth(self.depth_excitation(reduced, normalised))
        return depth, self.context(self.context_excitation(reduced, normalised))


class CameraExcitation(nn.Module):
    """A scale of each channel by a gate from the camera's vector."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.gate = nn.Sequential(
            nn.Linear(CAMERA_NUMBERS, channels),
            nn.ReLU(inplace=True),
            nn.Linear(channels, channels),
            nn.Linear(channels, channels),
            nn.ReLU(inplace=True),
            nn.Linear(channels, channels),
            nn.Sigmoid(),
        )

    def forward(self, features: Tensor, cameras: Tensor) -> Tensor:
        gate: Tensor = self.gate(cameras)
        return features * gate[:, :, None, None]


class ResidualBlock2d(nn.Module):
    """Two 3 × 3 convolutions beside the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(inplace=True),
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(channels),
        )

    def forward(self, features: Tensor) -> Tensor:
        return functional.relu(features + self.inner(features))


class DilatedPyramid2d(nn.Module):
    """Atrous spatial pyramid pooling: dilations 1, 6, 12, 18 and the mean of all (Chen et al., DeepLabv3, 2017)."""

    def __init__(self, channels: int, dropout: float) -> None:
        super().__init__()
        self.branches = nn.ModuleList([self._branch(channels, dilation) for dilation in (1, 6, 12, 18)])
        self.whole = nn.Sequential(nn.AdaptiveAvgPool2d(1), *self._branch(channels, 1))
        self.joined = nn.Sequential(*self._branch(5 * channels, 1, channels), nn.Dropout(dropout))

    def forward(self, features: Tensor) -> Tensor:
        whole = self.whole(features).expand_as(features)
        joined: Tensor = self.joined(torch.cat([*(branch(features) for branch in self.branches), whole], dim=1))
        return joined

    @staticmethod
    def _branch(channels: int, dilation: int, channels_out: int | None = None) -> nn.Sequential:
        width, size = channels_out or channels, 1 if dilation == 1 else 3
        convolution = nn.Conv2d(channels, width, size, padding="same", dilation=dilation, bias=False)
        nn.init.kaiming_normal_(convolution.weight)
        return nn.Sequential(convolution, nn.BatchNorm2d(width), nn.ReLU(inplace=True))
