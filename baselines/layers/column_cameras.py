"""Camera features of columns: features of a light network at the projections of each column's heights."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import CameraViews
from baselines.lattice import VoxelLattice
from baselines.layers.camera_projection import sightings_of
from baselines.layers.depth_network import ResidualBlock2d
from baselines.layers.efficient_vit import EfficientViTBlock
from baselines.layers.sensor_fusion import unit2d


class LightImageEncoder(nn.Module):
    """Images (M, 3, H, W), pooled by `pool`, to `channels` features at 1 / (4 `pool`) of their size."""

    def __init__(self, channels: int, pool: int) -> None:
        super().__init__()
        self.pool = pool
        self.layers = nn.Sequential(
            *halving(3, channels),
            *halving(channels, 2 * channels),
            *unit2d(2 * channels, 2 * channels, 3),
            *unit2d(2 * channels, channels, 3),
        )

    def cells_of(self, image: tuple[int, int]) -> tuple[int, int]:
        """Return the height and width of the features for images of this height and width."""
        height, width = (-(-(side // self.pool) // 4) for side in image)
        return height, width

    def forward(self, images: Tensor) -> Tensor:
        features: Tensor = self.layers(functional.avg_pool2d(images, self.pool) if self.pool > 1 else images)
        return features


class ColumnCameras(nn.Module):
    """Features (B, A · C, X, Y) of `lattice`'s columns at A heights each, the mean over the cameras that see them."""

    def __init__(self, channels: int, pool: int, lattice: VoxelLattice) -> None:
        super().__init__()
        self.lattice = lattice
        self.encoder = LightImageEncoder(channels, pool)

    def forward(self, views: CameraViews, grid_from_camera: Tensor, heights_m: Tensor) -> Tensor:
        """Return the features of the columns; `heights_m` (B, A, X, Y), grid frame."""
        frames, cameras = views.images.shape[:2]
        features: Tensor = self.encoder(views.images.flatten(0, 1))
        features = features.reshape(frames, cameras, *features.shape[1:])
        ground = self.lattice.centres_m(heights_m.device)[:, :, 0, :2].expand(*heights_m.shape, 2)
        points = torch.cat([ground, heights_m[..., None]], dim=-1)
        means = sightings_of(points.flatten(1, 3), features, views, grid_from_camera).means()
        return means.reshape(*heights_m.shape, -1).movedim(-1, 2).flatten(1, 2)


def halving(inputs: int, outputs: int) -> nn.Sequential:
    """Return a 3 × 3 convolution of stride 2, batch norm, ReLU."""
    convolution = nn.Conv2d(inputs, outputs, 3, stride=2, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


# A U-Net over a map of columns: residual blocks at each scale, attention over the whole map at the coarsest.


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
