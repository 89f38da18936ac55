"""Aggregator of TPVFormer: classes of voxels from the sum of the three planes' features.

Official: logits = classifier(output(softplus(hidden(top + front + side)))) of each voxel, after planes were scaled up.
Three identities reduce the operations. A linear layer of a sum is the sum over its terms. It may be applied before the
planes are scaled up, because bilinear weights add to one. Two consecutive linear layers are one. Source: Huang et al.,
CVPR 2023, equation 10; wzzheng/TPVFormer tpvformer10/tpv_aggregator.py.
"""

from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

from baselines.lattice import VoxelLattice
from baselines.layers.deformable_attention import at_least_float32
from baselines.layers.tpv.encoder import TriPlanes, plane_sizes

SLAB = 8  # along x; limits memory to 8 · 256 · 32 · 512 numbers at full size


@dataclass(frozen=True)
class TPVAggregatorConfig:
    """`lattice` is the model's: planes are coarser and are scaled up to it."""

    lattice: VoxelLattice
    channels: int = 256
    hidden_channels: int = 512
    classes: int = 4
    checkpoint_gradients: bool = False


class TPVAggregator(nn.Module):
    """Planes to logits (B, classes, X, Y, Z), float32 or wider."""

    def __init__(self, config: TPVAggregatorConfig) -> None:
        super().__init__()
        self.config = config
        self.hidden = nn.Linear(config.channels, config.hidden_channels)
        self.output = nn.Linear(config.hidden_channels, config.channels)
        self.classifier = nn.Linear(config.channels, config.classes)

    def forward(self, planes: TriPlanes) -> Tensor:
        sizes = plane_sizes(self.config.lattice)
        top, front, side = (self._hidden(maps, size) for maps, size in zip(planes, sizes, strict=True))
        last = self._last_two_layers()
        slabs = [
            self._through(near_top + self.hidden.bias, front, near_side, last)
            for near_top, near_side in zip(torch.split(top, SLAB, dim=1), torch.split(side, SLAB, dim=1), strict=True)
        ]
        return at_least_float32(torch.cat(slabs, dim=1).movedim(-1, 1))

    def _hidden(self, maps: Tensor, size: tuple[int, int]) -> Tensor:
        """Return a plane's term of the hidden layer, scaled up: (B, rows, columns, hidden channels)."""
        added = functional.conv2d(maps, self.hidden.weight[:, :, None, None])
        return functional.interpolate(added, size=size, mode="bilinear").movedim(1, -1)

    def _last_two_layers(self) -> tuple[Tensor, Tensor]:
        """Return weight and bias of output and classifier as one linear layer."""
        with torch.autocast(self.hidden.weight.device.type, enabled=False):
            weight = self.classifier.weight @ self.output.weight
            return weight, functional.linear(self.output.bias, self.classifier.weight, self.classifier.bias)

    def _through(self, *inputs: Any) -> Tensor:
        if self.config.checkpoint_gradients and self.training:
            return cast("Tensor", checkpoint(slab_logits, *inputs, use_reentrant=False))
        return slab_logits(*inputs)


def slab_logits(top: Tensor, front: Tensor, side: Tensor, last: tuple[Tensor, Tensor]) -> Tensor:
    """Return (B, x, Y, Z, classes) of (B, x, Y, hidden), (B, Y, Z, hidden) and (B, x, Z, hidden)."""
    hidden = top[:, :, :, None] + front[:, None] + side[:, :, None]
    return functional.linear(functional.softplus(hidden), *last)
