"""Feature pyramids: the maps of a backbone brought to one width, and to one scale or to several.

Source: Lin et al., Feature Pyramid Networks (CVPR 2017) as mmdet/models/necks/fpn.py; Yan et al., SECOND (Sensors
2018) as mmdet3d/models/necks/second_fpn.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional


@dataclass(frozen=True)
class FPNConfig:
    """Widths of the input maps, finest first, and of the output maps.

    `extra_levels` more maps, each half as large, are convolved from the backbone's coarsest map ("input") or the
    pyramid's ("output"); "pool" takes every other pixel instead.
    """

    in_channels: tuple[int, ...]
    out_channels: int = 256
    extra_levels: int = 0
    extra_from: Literal["input", "output", "pool"] = "output"
    relu_before_extra: bool = True


class FPN(nn.Module):
    """Maps (N, C_i, H_i, W_i), finest first, to `len(in_channels) + extra_levels` maps of `out_channels`."""

    def __init__(self, config: FPNConfig) -> None:
        super().__init__()
        self.config = config
        width = config.out_channels
        self.lateral_convs = nn.ModuleList([nn.Conv2d(channels, width, 1) for channels in config.in_channels])
        self.fpn_convs = nn.ModuleList([nn.Conv2d(width, width, 3, padding=1) for _ in config.in_channels])
        for number in range(0 if config.extra_from == "pool" else config.extra_levels):
            channels = config.in_channels[-1] if config.extra_from == "input" and number == 0 else width
            self.fpn_convs.append(nn.Conv2d(channels, width, 3, 2, padding=1))
        for module in self.modules():
            if isinstance(module, nn.Conv2d) and module.bias is not None:
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)

    def forward(self, maps: Sequence[Tensor]) -> tuple[Tensor, ...]:
        levels = [conv(level) for conv, level in zip(self.lateral_convs, maps, strict=True)]
        for fine in range(len(levels) - 1, 0, -1):
            size = levels[fine - 1].shape[2:]
            levels[fine - 1] = levels[fine - 1] + functional.interpolate(levels[fine], size=size, mode="nearest")
        outputs = [conv(level) for conv, level in zip(self.fpn_convs, levels, strict=False)]
        return (*outputs, *self._extra(maps[-1], outputs[-1]))

    def _extra(self, coarsest_input: Tensor, coarsest_output: Tensor) -> list[Tensor]:
        level = coarsest_input if self.config.extra_from == "input" else coarsest_output
        extra: list[Tensor] = []
        for number in range(self.config.extra_levels):
            if self.config.extra_from == "pool":
                level = level[:, :, ::2, ::2]
            else:
                fed = torch.relu(level) if number and self.config.relu_before_extra else level
                level = self.fpn_convs[len(self.config.in_channels) + number](fed)
            extra.append(level)
        return extra


class SecondFPN(nn.Module):
    """Maps (N, C_i, H_i, W_i), each scaled up by `upsample_strides[i]` (down if below 1), concatenated.

    All must come out at one size, so an image's height and width must be multiples of the coarsest stride.
    """

    def __init__(
        self, in_channels: Sequence[int], out_channels: Sequence[int], upsample_strides: Sequence[float]
    ) -> None:
        super().__init__()
        self.deblocks = nn.ModuleList(
            [
                nn.Sequential(rescaling(*widths), nn.BatchNorm2d(widths[1], eps=1e-3, momentum=0.01), nn.ReLU())
                for widths in zip(in_channels, out_channels, upsample_strides, strict=True)
            ]
        )

    def forward(self, maps: Sequence[Tensor]) -> Tensor:
        return torch.cat([block(level) for block, level in zip(self.deblocks, maps, strict=True)], dim=1)


def rescaling(channels_in: int, channels_out: int, stride: float) -> nn.Module:
    """Return a transposed convolution that scales up by `stride`, or a convolution that scales down by 1 / `stride`."""
    if stride >= 1:
        return nn.ConvTranspose2d(channels_in, channels_out, int(stride), int(stride), bias=False)
    step = round(1 / stride)
    return nn.Conv2d(channels_in, channels_out, step, step, bias=False)
