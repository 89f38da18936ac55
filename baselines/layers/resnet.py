"""ResNet of bottleneck blocks: images to four maps. Its keys are torchvision's, so that its checkpoints load.

**Conventions.** Maps have strides 4, 8, 16, 32. A deformable stage has `DeformableConv2d` for the 3 × 3 convolution of
each block, like mmdet's R101-DCN (stages 3 and 4). Source: He et al. (CVPR 2016); torchvision/models/resnet.py;
mmdet/models/backbones/resnet.py for `style`, `frozen_stages`, `norm_eval`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from baselines.layers.deformable_convolution import DeformableConv2d

BLOCKS = {14: (1, 1, 1, 1), 26: (2, 2, 2, 2), 50: (3, 4, 6, 3), 101: (3, 4, 23, 3)}
EXPANSION = 4


@dataclass(frozen=True)
class ResNetConfig:
    """`depth` 50 or 101 as published; 26 and 14 have fewer of the same blocks, for trials on a CPU.

    `style` selects the strided convolution of a block: "pytorch" the 3 × 3, "caffe" the 1 × 1 before it.
    `frozen_stages` −1 trains all; 0 freezes the stem, n the stem and the first n stages. With `norm_eval`, batch
    normalisation uses its stored statistics in training too.
    """

    depth: Literal[14, 26, 50, 101] = 50
    width: int = 64
    deformable_stages: tuple[bool, bool, bool, bool] = (False, False, False, False)
    style: Literal["pytorch", "caffe"] = "pytorch"
    frozen_stages: int = -1
    norm_eval: bool = False
    checkpoint_gradients: bool = False

    def channels(self) -> tuple[int, int, int, int]:
        """Return the numbers of channels of the four maps."""
        first = self.width * EXPANSION
        return first, 2 * first, 4 * first, 8 * first


class Bottleneck(nn.Module):
    """1 × 1, 3 × 3, 1 × 1 convolutions beside a shortcut, which is convolved if the shape changes."""

    def __init__(self, channels_in: int, width: int, stride: int, *, is_deformable: bool, style: str) -> None:
        super().__init__()
        channels_out = width * EXPANSION
        first, second = (1, stride) if style == "pytorch" else (stride, 1)
        self.conv1 = nn.Conv2d(channels_in, width, 1, first, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2: nn.Module = (
            DeformableConv2d(width, width, stride=second)
            if is_deformable
            else nn.Conv2d(width, width, 3, second, padding=1, bias=False)
        )
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, channels_out, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(channels_out)
        self.downsample: nn.Module = nn.Identity()
        if stride != 1 or channels_in != channels_out:
            self.downsample = nn.Sequential(
                nn.Conv2d(channels_in, channels_out, 1, stride, bias=False), nn.BatchNorm2d(channels_out)
            )

    def forward(self, maps: Tensor) -> Tensor:
        inner = torch.relu(self.bn1(self.conv1(maps)))
        inner = torch.relu(self.bn2(self.conv2(inner)))
        return torch.relu(self.bn3(self.conv3(inner)) + self.downsample(maps))


class ResNet(nn.Module):
    """Images (N, 3, H, W) to four maps of `config.channels()` channels."""

    def __init__(self, config: ResNetConfig) -> None:
        super().__init__()
        self.config = config
        self.conv1 = nn.Conv2d(3, config.width, 7, 2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(config.width)
        self.maxpool = nn.MaxPool2d(3, 2, padding=1)
        self.layer1, self.layer2, self.layer3, self.layer4 = (self._stage(index) for index in range(4))
        for module in self.modules():
            if isinstance(module, nn.Conv2d) and module.bias is None:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
        for part in self._frozen_parts():
            part.requires_grad_(requires_grad=False)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        maps = self.maxpool(torch.relu(self.bn1(self.conv1(images))))
        stages = []
        for stage in self._stages():
            for block in stage:
                maps = self._through(block, maps)
            stages.append(maps)
        return stages[0], stages[1], stages[2], stages[3]

    def train(self, mode: bool = True) -> "ResNet":
        super().train(mode)
        held = list(self.modules()) if self.config.norm_eval else [m for p in self._frozen_parts() for m in p.modules()]
        for module in held:
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self

    def load_pretrained(self, state: Mapping[str, Tensor]) -> None:
        """Load the weights of a torchvision (or mmdet) state dict; offsets of deformable stages may be missing there.

        A classifier in it is ignored. Raises `ValueError` if another key is missing or has another shape.
        """
        own = self.state_dict()
        taken = {key: value for key, value in state.items() if key in own and value.shape == own[key].shape}
        lacking = [key for key in own if key not in taken and "conv_offset" not in key and "num_batches" not in key]
        if lacking:
            raise ValueError(f"{len(lacking)} weights of this ResNet are not in the checkpoint, {lacking[0]} the first")
        self.load_state_dict(taken, strict=False)

    def _stage(self, index: int) -> nn.Sequential:
        config, width = self.config, self.config.width << index
        channels_in = config.width if index == 0 else width * EXPANSION // 2
        blocks = []
        for number in range(BLOCKS[config.depth][index]):
            stride = 2 if index and not number else 1
            is_deformable = config.deformable_stages[index]
            blocks.append(Bottleneck(channels_in, width, stride, is_deformable=is_deformable, style=config.style))
            channels_in = width * EXPANSION
        return nn.Sequential(*blocks)

    def _stages(self) -> tuple[nn.Sequential, ...]:
        return self.layer1, self.layer2, self.layer3, self.layer4

    def _frozen_parts(self) -> tuple[nn.Module, ...]:
        parts: tuple[nn.Module, ...] = (self.conv1, self.bn1) if self.config.frozen_stages >= 0 else ()
        return parts + self._stages()[: max(self.config.frozen_stages, 0)]

    def _through(self, block: nn.Module, maps: Tensor) -> Tensor:
        if self.config.checkpoint_gradients and self.training:
            return cast("Tensor", checkpoint(block, maps, use_reentrant=False))
        return cast("Tensor", block(maps))
