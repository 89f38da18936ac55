"""Feature pyramid over volumes: coarse levels are added to finer ones, all with the same channels.

Source: OpenOccupancy's `occ_plugin/occupancy/necks/fpn3d.py`, `FPN3D`.
"""

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint


class FPN3d(nn.Module):
    """Volumes of `channels_in`, finest first, to as many of `channels_out`."""

    def __init__(self, channels_in: Sequence[int], channels_out: int) -> None:
        super().__init__()
        self.checkpoint_gradients = False
        self.laterals = nn.ModuleList(normed_convolution3d(channels, channels_out, 1) for channels in channels_in)
        self.outputs = nn.ModuleList(normed_convolution3d(channels_out, channels_out, 3) for _ in channels_in)

    def forward(self, volumes: Sequence[Tensor]) -> tuple[Tensor, ...]:
        laterals = [self.run(layer, volume) for layer, volume in zip(self.laterals, volumes, strict=True)]
        for i in range(len(laterals) - 1, 0, -1):
            laterals[i - 1] = laterals[i - 1] + resized(laterals[i], laterals[i - 1])
        return tuple(self.run(layer, lateral) for layer, lateral in zip(self.outputs, laterals, strict=True))

    def run(self, layer: nn.Module, volume: Tensor) -> Tensor:
        if self.checkpoint_gradients and volume.requires_grad:
            return checkpoint(layer, volume, use_reentrant=False)  # type: ignore[no-any-return]
        return layer(volume)  # type: ignore[no-any-return]


def normed_convolution3d(channels_in: int, channels_out: int, size: int) -> nn.Sequential:
    """Return a convolution that keeps the shape, batch norm, ReLU."""
    convolution = nn.Conv3d(channels_in, channels_out, size, padding=size // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm3d(channels_out), nn.ReLU())


def resized(volume: Tensor, like: Tensor) -> Tensor:
    """Return the volume resized trilinearly, cell for cell: corners are the corners of the outermost cells."""
    return functional.interpolate(volume, size=like.shape[2:], mode="trilinear", align_corners=False)
