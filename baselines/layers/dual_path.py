"""OccFormer's 3D encoder: window attention shared by the slices of a volume and its view from above.

**Conventions.** Volumes are (B, C, X, Y, Z). A block's local path processes every horizontal slice; its global path the
mean over z, followed by dilated convolutions. A gate of each voxel weights the global path.

Source: Zhang et al., OccFormer, ICCV 2023, section 3.2; zhangyp15/OccFormer, backbones/{occnet,dualpath_block}.py and
backbones/modules/aspp.py.
"""

from dataclasses import dataclass, field
from math import gcd

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from baselines.layers.shifted_windows import ShiftedWindowBlock, WindowSettings

NORM_GROUPS = 32
REDUCTION = 4  # fewer channels within the dilated convolutions
DILATIONS = (6, 12, 18)


@dataclass(frozen=True)
class DualPathSettings:
    """`channels` and `blocks` of each stage; all but the first halve the resolution. `inputs`: input channels."""

    inputs: int = 128
    channels: tuple[int, ...] = (128, 256, 512, 1024)
    blocks: tuple[int, ...] = (2, 2, 2, 2)
    windows: WindowSettings = field(default_factory=WindowSettings)
    dropout: float = 0.1
    checkpoint_gradients: bool = False


@dataclass(frozen=True)
class BlockPlan:
    """The channels of one block; `stride` along all axes."""

    inputs: int
    outputs: int
    stride: int
    is_shifted: bool


class DualPathEncoder(nn.Module):
    """(B, C, X, Y, Z) → a volume of each stage, the finest first."""

    def __init__(self, settings: DualPathSettings) -> None:
        super().__init__()
        self.checkpoint_gradients = settings.checkpoint_gradients
        self.stages = nn.ModuleList(
            nn.Sequential(*(DualPathBlock(plan, settings) for plan in stage)) for stage in planned(settings)
        )

    def forward(self, volume: Tensor) -> tuple[Tensor, ...]:
        volumes = []
        for stage in self.stages:
            is_saving = self.checkpoint_gradients and self.training
            volume = checkpoint(stage, volume, use_reentrant=False) if is_saving else stage(volume)
            volumes.append(volume)
        return tuple(volumes)


class DualPathBlock(nn.Module):
    """A convolution, window attention shared by all slices and their mean, the mean's wide context, and a skip."""

    def __init__(self, plan: BlockPlan, settings: DualPathSettings) -> None:
        super().__init__()
        inputs, outputs, stride = plan.inputs, plan.outputs, plan.stride
        self.convolution = nn.Sequential(
            nn.Conv3d(inputs, outputs, 3, stride, padding=1, bias=False), group_norm(outputs), nn.ReLU(inplace=True)
        )
        self.windows = ShiftedWindowBlock(outputs, plan.is_shifted, settings.windows)
        self.context = BottleneckContext(outputs, settings.dropout)
        self.gate = nn.Conv3d(outputs, 1, 1)
        self.skip: nn.Module = nn.Identity()
        if stride > 1 or inputs != outputs:
            self.skip = nn.Sequential(nn.Conv3d(inputs, outputs, 1, stride, bias=False), group_norm(outputs))

    def forward(self, volume: Tensor) -> Tensor:
        x = self.convolution(volume)
        b, z = len(x), x.shape[-1]
        slices = x.permute(0, 4, 1, 2, 3).flatten(0, 1)
        seen = self.windows(torch.cat((x.mean(dim=-1), slices)))
        above, slices = seen[:b], seen[b:]
        local = slices.unflatten(0, (b, z)).permute(0, 2, 3, 4, 1)
        answered: Tensor = local + self.gate(local).sigmoid() * self.context(above)[..., None] + self.skip(volume)
        return answered


class BottleneckContext(nn.Module):
    """Dilated convolutions on a quarter of the channels, added to their input: (B, C, X, Y) → the same."""

    def __init__(self, channels: int, dropout: float) -> None:
        super().__init__()
        narrow = channels // REDUCTION
        self.reduce = nn.Sequential(
            nn.Conv2d(channels, narrow, 1, bias=False), group_norm(narrow), nn.ReLU(inplace=True)
        )
        self.dilated = DilatedContext(narrow, dropout)
        self.expand = nn.Sequential(
            nn.Conv2d(narrow, channels, 1, bias=False), group_norm(channels), nn.ReLU(inplace=True)
        )

    def forward(self, maps: Tensor) -> Tensor:
        widened: Tensor = self.expand(self.dilated(self.reduce(maps)))
        return maps + widened


class DilatedContext(nn.Module):
    """Atrous spatial pyramid pooling with as many channels throughout, added to its input (Chen et al., DeepLabv3)."""

    def __init__(self, channels: int, dropout: float) -> None:
        super().__init__()
        self.branches = nn.ModuleList(dilated_convolution(channels, dilation) for dilation in (0, *DILATIONS))
        self.pooled = nn.Sequential(nn.AdaptiveAvgPool2d(1), dilated_convolution(channels, 0))
        self.merge = nn.Sequential(
            nn.Conv2d(5 * channels, channels, 1, bias=False), pyramid_norm(channels), nn.ReLU(inplace=True)
        )
        self.dropout = nn.Dropout(dropout)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight)

    def forward(self, maps: Tensor) -> Tensor:
        everywhere = self.pooled(maps).expand_as(maps)
        pyramid = torch.cat([branch(maps) for branch in self.branches] + [everywhere], dim=1)
        merged: Tensor = self.dropout(self.merge(pyramid))
        return maps + merged


def planned(settings: DualPathSettings) -> list[list[BlockPlan]]:
    """Return the blocks of every stage; counted over all stages, every second block shifts its windows."""
    stages, inputs, index = [], settings.inputs, 0
    for stage, (channels, count) in enumerate(zip(settings.channels, settings.blocks, strict=True)):
        blocks = []
        for number in range(count):
            stride = 2 if stage > 0 and number == 0 else 1
            blocks.append(BlockPlan(inputs, channels, stride, is_shifted=index % 2 == 1))
            inputs, index = channels, index + 1
        stages.append(blocks)
    return stages


def dilated_convolution(channels: int, dilation: int) -> nn.Sequential:
    """Return a 3 × 3 convolution of this dilation (1 × 1 for 0), normalised, and rectified."""
    convolution = (
        nn.Conv2d(channels, channels, 3, padding=dilation, dilation=dilation, bias=False)
        if dilation
        else nn.Conv2d(channels, channels, 1, bias=False)
    )
    return nn.Sequential(convolution, pyramid_norm(channels), nn.ReLU(inplace=True))


def group_norm(channels: int) -> nn.GroupNorm:
    """Return a normalisation in 32 groups, or fewer if they do not divide the channels."""
    return nn.GroupNorm(gcd(NORM_GROUPS, channels), channels)


def pyramid_norm(channels: int) -> nn.GroupNorm:
    """Return a group norm with at least two channels per group (official)."""
    return group_norm(channels) if channels > NORM_GROUPS else nn.GroupNorm(channels // 2, channels)
