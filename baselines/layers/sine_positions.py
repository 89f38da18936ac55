"""Positions of a volume's voxels as sines and cosines.

Source: Carion et al., DETR, ECCV 2020, in three dimensions: zhangyp15/OccFormer, mask2former/positional_encodings
(`SinePositionalEncoding3D`, normalised).
"""

from math import tau

import torch
from torch import Tensor

from baselines.lattice import Shape

TEMPERATURE = 10_000.0
EPSILON = 1e-6


def sine_positions(shape: Shape, channels: int, device: torch.device | None = None) -> Tensor:
    """(X·Y·Z, channels) float32: a third of the channels for each axis, whose length is one period of the slowest wave.

    `channels` is a multiple of 6: sine and cosine by turns.
    """
    each = channels // 3
    exponent = 2.0 * torch.div(torch.arange(each, device=device), 2, rounding_mode="floor") / each
    axes = []
    for axis, length in enumerate(shape):
        place = torch.arange(1, length + 1, device=device, dtype=torch.float32)
        phase = (place / (length + EPSILON) * tau)[:, None] / TEMPERATURE**exponent
        waves = torch.stack((phase[:, 0::2].sin(), phase[:, 1::2].cos()), dim=2).flatten(1)
        axes.append(waves.reshape([length if a == axis else 1 for a in range(3)] + [each]).expand(*shape, each))
    return torch.cat(axes, dim=3).flatten(0, 2)
