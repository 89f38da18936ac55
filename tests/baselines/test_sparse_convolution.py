"""Sparse convolutions, and an encoder of them, are dense ones, looked at where voxels are."""

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import Points
from baselines.lattice import Shape, VoxelLattice
from baselines.layers.fpn3d import FPN3d
from baselines.layers.residual3d import ResNet3d
from baselines.layers.sparse_convolution import (
    Rulebook,
    SparseConvolution3d,
    SparseEncoder,
    SparseVoxels,
    halved,
    means_of_points,
    strided_rules,
    submanifold_rules,
)

SHAPES: list[Shape] = [(6, 5, 4), (7, 8, 3), (1, 1, 9), (2, 2, 2)]


def occupied(shape: Shape, share: float, channels: int = 3) -> SparseVoxels:
    """Voxels of two frames by chance, in float64."""
    random = torch.Generator().manual_seed(shape[0])
    total = 2 * shape[0] * shape[1] * shape[2]
    keys = (torch.rand(total, generator=random) < share).nonzero()[:, 0]
    features = torch.randn(len(keys), channels, generator=random, dtype=torch.float64)
    return SparseVoxels(features.requires_grad_(), keys, shape, 2)


def convolution(channels_in: int = 3, channels_out: int = 4) -> SparseConvolution3d:
    torch.manual_seed(0)
    layer = SparseConvolution3d(channels_in, channels_out, bias=True).double()
    torch.nn.init.normal_(layer.bias)
    return layer


def densely(layer: SparseConvolution3d, voxels: SparseVoxels, stride: int) -> Tensor:
    return functional.conv3d(voxels.dense(), layer.dense_weight(), layer.bias, stride, padding=1)


def gradients(output: Tensor, voxels: SparseVoxels, layer: SparseConvolution3d) -> tuple[Tensor, ...]:
    return torch.autograd.grad(output.square().sum(), (voxels.features, layer.weight, layer.bias))  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("stride", [1, 2])
def test_a_sparse_convolution_and_its_gradients_are_the_dense_ones(shape: Shape, share: float, stride: int) -> None:
    voxels, layer = occupied(shape, share), convolution()
    rules = submanifold_rules(voxels) if stride == 1 else strided_rules(voxels)
    sparse = layer(voxels, rules)
    frame, x, y, z = sparse.indices().unbind(dim=1)
    dense = densely(layer, voxels, stride)[frame, :, x, y, z]
    assert torch.allclose(sparse.features, dense, rtol=0, atol=1e-12)
    for ours, theirs in zip(gradients(sparse.features, voxels, layer), gradients(dense, voxels, layer), strict=True):
        assert torch.allclose(ours, theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_strided_convolution_leaves_out_what_no_voxel_reaches(shape: Shape) -> None:
    voxels = occupied(shape, 0.1)
    rules = strided_rules(voxels)
    reached = SparseVoxels(torch.ones(len(voxels.keys), 1), voxels.keys, shape, 2).dense()
    expected = functional.conv3d(reached, torch.ones(1, 1, 3, 3, 3), stride=2, padding=1) > 0
    assert rules.shape == halved(shape) == expected.shape[2:]
    assert torch.equal(rules.keys, expected.flatten().nonzero()[:, 0])


def test_no_voxels_convolve_to_none() -> None:
    nothing, layer = occupied((4, 4, 4), 0.0), convolution()
    for rules in (submanifold_rules(nothing), strided_rules(nothing)):
        assert isinstance(rules, Rulebook)
        assert layer(nothing, rules).features.shape == (0, 4)


def test_bfloat16_products_are_added_up_in_float32() -> None:
    voxels, layer = occupied((6, 5, 4), 0.5), convolution().float()
    voxels = voxels.with_features(voxels.features.detach().float())
    rules = submanifold_rules(voxels)
    with torch.autocast("cpu", torch.bfloat16):
        half = layer(voxels, rules).features
    assert half.dtype == torch.float32
    assert torch.allclose(half, layer(voxels, rules).features, atol=0.05)


def test_a_voxel_holds_the_mean_of_its_points_and_none_of_those_outside() -> None:
    random = torch.Generator().manual_seed(1)
    place = torch.rand(400, 3, generator=random) * 6 - 1
    place[0] = torch.nan
    points = Points(torch.cat([place, torch.rand(400, 2, generator=random)], dim=1), torch.arange(400) // 200)
    lattice = VoxelLattice((0.0, 0.0, 0.0), (1.0, 2.0, 1.0), (4, 2, 4))
    voxels = means_of_points(points, points.features, lattice, 3)
    dense = voxels.dense()
    assert dense.shape == (3, 5, 4, 2, 4)
    assert not dense[2].any()
    for frame, x, y, z in voxels.indices().tolist():
        low = torch.tensor([x, 2 * y, z])
        mine = points.frame == frame
        mine &= ((place >= low) & (place < low + torch.tensor([1, 2, 1]))).all(dim=1)
        assert torch.allclose(dense[frame, :, x, y, z], points.features[mine].mean(dim=0))
    cells = torch.cat([points.frame[:, None], torch.floor(place / torch.tensor([1, 2, 1]))], dim=1)
    is_inside = ((place >= 0) & (place < 4)).all(dim=1)
    assert len(voxels.keys) == len(torch.unique(cells[is_inside], dim=0))


torch.set_num_threads(1)


def full_lattice(frames: int = 2) -> SparseVoxels:
    torch.manual_seed(0)
    total = frames * 16 * 8 * 8
    return SparseVoxels(torch.randn(total, 4).double(), torch.arange(total), (16, 8, 8), frames)


def normed(layer: Any, volume: Tensor) -> Tensor:
    return layer(volume.movedim(1, -1).flatten(0, 3)).view(*volume.movedim(1, -1).shape).movedim(-1, 1)  # type: ignore[no-any-return]


def convolved(layer: Any, volume: Tensor, stride: int = 1) -> Tensor:
    return functional.conv3d(volume, layer.dense_weight(), layer.bias, stride, padding=1)


def densely_encoded(encoder: Any, volume: Tensor) -> Tensor:
    """The official network, in dense layers."""
    volume = normed(encoder.first.norm, convolved(encoder.first.convolution, volume)).relu()
    for stage in encoder.stages:
        if stage.down is not None:
            volume = normed(stage.down.norm, convolved(stage.down.convolution, volume, stride=2)).relu()
        for block in stage.blocks:
            inner = normed(block.first.norm, convolved(block.first.convolution, volume)).relu()
            volume = (normed(block.norm, convolved(block.second, inner)) + volume).relu()
    return normed(encoder.last.norm, convolved(encoder.last.convolution, volume)).relu()


@pytest.mark.parametrize("ratio", [4, 8])
def test_on_a_full_lattice_the_sparse_encoder_is_a_dense_one(ratio: int) -> None:
    voxels = full_lattice()
    encoder = SparseEncoder(4, 4, 6, ratio).double()
    encoded = encoder(voxels)
    assert encoded.shape == (2, 6, 16 // ratio, 8 // ratio, 8 // ratio)
    encoder.eval()
    assert torch.allclose(encoder(voxels), densely_encoded(encoder, voxels.dense()), atol=1e-10)


def test_what_points_measure_is_seen_beside_where_they_are() -> None:
    """The official first norm, over groups of one number, leaves only the latter."""
    voxels, encoder = full_lattice(), SparseEncoder(4, 16, 6, 8).double()
    other = voxels.with_features(voxels.features.flip(0))
    assert not torch.allclose(encoder(voxels), encoder(other), atol=0.01)


def test_volumes_halve_and_the_pyramid_gives_them_the_same_channels() -> None:
    residual, pyramid = ResNet3d(3, (4, 8, 8, 16), (1, 2, 1, 1)), FPN3d((4, 8, 8, 16), 6)
    volumes = residual(torch.randn(2, 3, 16, 8, 9))
    assert [tuple(volume.shape[1:]) for volume in volumes] == [(4, 16, 8, 9), (8, 8, 4, 5), (8, 4, 2, 3), (16, 2, 1, 2)]
    levels = pyramid(volumes)
    assert [tuple(level.shape[1:]) for level in levels] == [(6, *volume.shape[2:]) for volume in volumes]
    levels[0].sum().backward()
    assert all(parameter.grad is not None for parameter in residual.parameters())
