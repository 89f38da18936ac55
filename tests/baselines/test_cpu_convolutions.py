"""Convolutions in bfloat16 on this processor: near those in single precision, whatever the shape.

On a processor with matrix tiles (AMX) this fails where `baselines` does not keep oneDNN from them.
"""

import pytest
import torch

import baselines  # noqa: F401  # it chooses the instructions, before oneDNN is first used

FAR = 0.01  # bfloat16 keeps eight bits: 0.003 was measured


@pytest.mark.parametrize("channels", [8, 12, 16, 24, 64])
@pytest.mark.parametrize("side", [2, 4, 8, 16])
@pytest.mark.parametrize("stride", [1, 2, 4, 8, 16])
def test_a_convolution_in_bfloat16_is_near_that_in_single_precision(channels: int, side: int, stride: int) -> None:
    torch.manual_seed(0)
    images, weights = torch.randn(2, channels, 16, 24), torch.randn(16, channels, side, side)
    exact = torch.conv2d(images, weights, stride=stride)
    near = torch.conv2d(images.bfloat16(), weights.bfloat16(), stride=stride).float()
    assert (near - exact).norm() < FAR * exact.norm()
