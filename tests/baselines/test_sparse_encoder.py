"""The sparse encoder is the dense network of its weights where all voxels are occupied, and sees what points are."""

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from baselines.layers.fpn3d import FPN3d
from baselines.layers.residual3d import ResNet3d
from baselines.layers.sparse_encoder import SparseEncoder
from baselines.layers.sparse_voxels import SparseVoxels

torch.set_num_threads(1)


def full_lattice(frames: int = 2) -> SparseVoxels:
    torch.manual_seed(0)
    total = frames * 16 * 8 * 8
    return SparseVoxels(torch.randn(total, 4).double(), torch.arange(total), (16, 8, 8), frames)


def norm(layer: Any, volume: Tensor) -> Tensor:
    return layer(volume.movedim(1, -1).flatten(0, 3)).view(*volume.movedim(1, -1).shape).movedim(-1, 1)  # type: ignore[no-any-return]


def convolved(layer: Any, volume: Tensor, stride: int = 1) -> Tensor:
    return functional.conv3d(volume, layer.dense_weight(), layer.bias, stride, padding=1)


def densely(encoder: Any, volume: Tensor) -> Tensor:
    """The official network, in dense layers."""
    volume = norm(encoder.first.norm, convolved(encoder.first.convolution, volume)).relu()
    for stage in encoder.stages:
        if stage.down is not None:
            volume = norm(stage.down.norm, convolved(stage.down.convolution, volume, stride=2)).relu()
        for block in stage.blocks:
            inner = norm(block.first.norm, convolved(block.first.convolution, volume)).relu()
            volume = (norm(block.norm, convolved(block.second, inner)) + volume).relu()
    return norm(encoder.last.norm, convolved(encoder.last.convolution, volume)).relu()


@pytest.mark.parametrize("ratio", [4, 8])
def test_on_a_full_lattice_the_sparse_encoder_is_a_dense_one(ratio: int) -> None:
    voxels = full_lattice()
    encoder = SparseEncoder(4, 4, 6, ratio).double()
    encoded = encoder(voxels)
    assert encoded.shape == (2, 6, 16 // ratio, 8 // ratio, 8 // ratio)
    encoder.eval()
    assert torch.allclose(encoder(voxels), densely(encoder, voxels.dense()), atol=1e-10)


def test_what_points_measure_is_seen_beside_where_they_are() -> None:
    """The official first norm, over groups of one number, leaves only the latter."""
    voxels, encoder = full_lattice(), SparseEncoder(4, 16, 6, 8).double()
    other = voxels.with_features(voxels.features.flip(0))
    assert not torch.allclose(encoder(voxels), encoder(other), atol=0.01)


def test_officials_have_exactly_these_numbers_of_parameters() -> None:
    with torch.device("meta"):
        counts = [sum(p.numel() for p in SparseEncoder(4, 16, 80, ratio).parameters()) for ratio in (8, 4)]
    assert counts == [2_893_472, 791_072]


def test_volumes_halve_and_the_pyramid_gives_them_the_same_channels() -> None:
    residual, pyramid = ResNet3d(3, (4, 8, 8, 16), (1, 2, 1, 1)), FPN3d((4, 8, 8, 16), 6)
    volumes = residual(torch.randn(2, 3, 16, 8, 9))
    assert [tuple(volume.shape[1:]) for volume in volumes] == [(4, 16, 8, 9), (8, 8, 4, 5), (8, 4, 2, 3), (16, 2, 1, 2)]
    levels = pyramid(volumes)
    assert [tuple(level.shape[1:]) for level in levels] == [(6, *volume.shape[2:]) for volume in volumes]
    levels[0].sum().backward()
    assert all(parameter.grad is not None for parameter in residual.parameters())
