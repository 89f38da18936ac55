"""CoNet's cascade: children of coarse cells that are predicted occupied are classified one by one.

Source: Wang et al., OpenOccupancy, section 4.3; `OccHead.forward`, `utils/coordinate_transform.py`. There child i of n
is sampled and projected at i / (n − 1) of the grid's extent, up to half a voxel aside; here at its centre, (i + ½) / n.
There at most 100,000 random cells are refined when predicting; here all are.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import Batch
from baselines.layers.image_samples import image_samples
from baselines.losses.voxels import FREE
from baselines.models.occupancy_model import CLASSES
from baselines.models.openocc_config import OpenOccConfig
from baselines.models.openocc_head import CoarseVolume

CHUNK = 2**17  # number of children classified at once


@dataclass(frozen=True, eq=False)
class FineVoxels:
    """Logits (N, 4) of the voxels of the fine lattice with `indices` (N, 4): frame, x, y, z."""

    logits: Tensor
    indices: Tensor


@dataclass(frozen=True, eq=False)
class FrameEvidence:
    """The inputs for children of one frame: its volume (C, x, y, z), and its images' (K, C', H', W')."""

    volume: Tensor
    images: Tensor | None
    batch: Batch
    frame: int


class Cascade(nn.Module):
    """A perceptron on the coarse volume, and images if there are any, at a child's centre."""

    def __init__(self, config: OpenOccConfig) -> None:
        super().__init__()
        self.config = config
        width = config.fine_channels
        known = config.pyramid_channels // 2
        if config.has_cameras:
            squeeze = nn.Conv2d(config.image_channels, 2 * width, 1)
            self.squeeze = nn.Sequential(squeeze, nn.GroupNorm(width // 4, 2 * width), nn.ReLU())
            self.image_mlp = nn.Sequential(*normed_linear(2 * width, width))
            known += width
        self.mlp = nn.Sequential(*normed_linear(known, width), nn.Linear(width, CLASSES))

    def forward(self, coarse: CoarseVolume, batch: Batch, image_features: Tensor | None) -> FineVoxels:
        """Return the refined voxels from `image_features` (B, K, C', H', W'); in training at most `refined_cells` cells
        per frame.
        """
        most = self.config.refined_cells if self.training else None
        images = None if image_features is None else self.squeezed(image_features)
        logits: list[Tensor] = []
        indices: list[Tensor] = []
        for frame in range(len(batch)):
            evidence = FrameEvidence(coarse.features[frame], None if images is None else images[frame], batch, frame)
            cells = occupied_cells(coarse.logits[frame], most)
            for part in torch.split(children(cells, self.config.coarse_ratio), CHUNK):
                logits.append(self.mlp(self.samples(part, evidence)))
                indices.append(functional.pad(part, (1, 0), value=frame))
        return FineVoxels(torch.cat(logits), torch.cat(indices))

    def squeezed(self, image_features: Tensor) -> Tensor:
        """Return the features of the images with fewer channels."""
        squeezed: Tensor = self.squeeze(image_features.flatten(0, 1))
        return squeezed.view(*image_features.shape[:2], *squeezed.shape[1:])

    def samples(self, voxels: Tensor, evidence: FrameEvidence) -> Tensor:
        """Return the features (N, C) of the fine voxels (N, 3)."""
        known = volume_samples(evidence.volume, voxels, self.config.coarse_ratio)
        if evidence.images is None:
            return known
        lattice = self.config.lattice
        size, low = known.new_tensor(lattice.voxel_m), known.new_tensor(lattice.min_m)
        seen = image_samples(evidence.images, low + (voxels + 0.5) * size, evidence.batch, evidence.frame)
        return torch.cat([known, self.image_mlp(seen)], dim=1)


def occupied_cells(logits: Tensor, most: int | None) -> Tensor:
    """Return cells (N, 3) that logits (4, x, y, z) predict occupied; a random `most` of them if there are more."""
    cells = (logits.argmax(dim=0) != FREE).nonzero()
    if most is None or len(cells) <= most:
        return cells
    return cells[torch.randperm(len(cells), device=cells.device)[:most]]


def children(cells: Tensor, ratio: int) -> Tensor:
    """Return the ratio³ fine voxels (N · ratio³, 3) of each of the cells (N, 3)."""
    steps = torch.arange(ratio, device=cells.device)
    inside = torch.cartesian_prod(steps, steps, steps).view(-1, 3)
    return (cells[:, None] * ratio + inside).flatten(0, 1)


def volume_samples(volume: Tensor, voxels: Tensor, ratio: int) -> Tensor:
    """Return trilinear samples (N, C) of a coarse volume (C, x, y, z) at the centres of fine voxels (N, 3), float32.

    Beyond the centres of the outermost cells it is constant.
    """
    shape = voxels.new_tensor(volume.shape[1:]) * ratio
    places = (voxels + 0.5) / shape * 2 - 1
    grid = places.flip(1)[None, :, None, None].float()  # grid_sample takes the last axis first
    samples = functional.grid_sample(volume[None].float(), grid, padding_mode="border", align_corners=False)
    return samples[0, :, :, 0, 0].T


def normed_linear(channels_in: int, channels_out: int) -> tuple[nn.Module, ...]:
    """Return linear, a norm over groups of four channels, ReLU."""
    return nn.Linear(channels_in, channels_out), nn.GroupNorm(channels_out // 4, channels_out), nn.ReLU()
