"""A residual network over dense volumes: 3D ResNet-18, from one volume to four, each half as fine as the one before.

Source: OpenOccupancy's `occ_plugin/occupancy/backbones/resnet3d.py`, `CustomResNet3D`; its convolutions have biases
though batch norms follow.
"""

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint


class ResidualBlock3d(nn.Module):
    """Two 3 × 3 × 3 convolutions beside the identity, or beside a 1 × 1 × 1 convolution if the shape changes."""

    def __init__(self, channels_in: int, channels_out: int, stride: int) -> None:
        super().__init__()
        self.first = nn.Conv3d(channels_in, channels_out, 3, stride, 1)
        self.first_norm = nn.BatchNorm3d(channels_out)
        self.second = nn.Conv3d(channels_out, channels_out, 3, 1, 1)
        self.second_norm = nn.BatchNorm3d(channels_out)
        self.shortcut = nn.Sequential()
        if stride != 1 or channels_in != channels_out:
            self.shortcut.append(nn.Conv3d(channels_in, channels_out, 1, stride))
            self.shortcut.append(nn.BatchNorm3d(channels_out))

    def forward(self, volume: Tensor) -> Tensor:
        inner = functional.relu(self.first_norm(self.first(volume)))
        return functional.relu(self.second_norm(self.second(inner)) + self.shortcut(volume))


class ResNet3d(nn.Module):
    """Volumes of `channels`, after `blocks` blocks each; the first is as fine as the input."""

    def __init__(self, channels_in: int, channels: Sequence[int], blocks: Sequence[int]) -> None:
        super().__init__()
        self.checkpoint_gradients = False
        self.projection = nn.Sequential(
            nn.Conv3d(channels_in, channels[0], 1, bias=False), nn.BatchNorm3d(channels[0]), nn.ReLU()
        )
        widths = [channels[0], *channels]
        self.stages = nn.ModuleList(
            residual_stage(widths[i], widths[i + 1], count, stride=1 if i == 0 else 2) for i, count in enumerate(blocks)
        )
        for module in self.modules():
            if isinstance(module, nn.Conv3d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, volume: Tensor) -> tuple[Tensor, ...]:
        volumes = [self.projection(volume)]
        for stage in self.stages:
            if self.checkpoint_gradients and volumes[-1].requires_grad:
                volumes.append(checkpoint(stage, volumes[-1], use_reentrant=False))
            else:
                volumes.append(stage(volumes[-1]))
        return tuple(volumes[1:])


def residual_stage(channels_in: int, channels_out: int, blocks: int, *, stride: int) -> nn.Sequential:
    first = ResidualBlock3d(channels_in, channels_out, stride)
    return nn.Sequential(first, *(ResidualBlock3d(channels_out, channels_out, 1) for _ in range(blocks - 1)))
