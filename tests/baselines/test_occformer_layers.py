"""OccFormer's layers against slow loops: windows, deformable attention in volumes, positions, masked attention."""

from itertools import product
from math import cos, floor, pi, sin

import pytest
import torch
from torch import Tensor, nn

from baselines.lattice import Shape
from baselines.layers.deformable_attention3d import (
    DeformableAttention3D,
    DeformableSettings3D,
    sample_volumes,
    voxel_places,
)
from baselines.layers.dual_path import DualPathEncoder, DualPathSettings
from baselines.layers.masked_attention import MaskDecoder, MaskDecoderLayer, MemoryTokens, QuerySettings, hidden_voxels
from baselines.layers.pixel_decoder3d import PixelDecoder3D, PixelDecoderSettings
from baselines.layers.shifted_windows import ShiftedWindowBlock, WindowAttention, WindowSettings, stochastic_depth
from baselines.layers.sine_positions import sine_positions

SHAPES: tuple[Shape, ...] = ((2, 3, 2), (4, 3, 3))
SMALL_WINDOWS = WindowSettings(window=3, head_channels=8, drop_path=0.0)
SMALL_PATHS = DualPathSettings(16, (16, 32, 32, 64), (2, 1, 1, 1), SMALL_WINDOWS, dropout=0.0)
SMALL_PIXELS = PixelDecoderSettings((16, 32, 32, 64), DeformableSettings3D(12, 2), layers=2, hidden=24)
SMALL_QUERIES = QuerySettings(queries=5, channels=12, heads=2, layers=4, hidden=24)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)


def slowly_attended(attention: WindowAttention, cells: Tensor, window: int, shift: int) -> Tensor:
    """Each cell by itself: it sees those of its window, whose borders lie `shift` cells further than without it."""
    height, width, channels = cells.shape
    q, k, v = attention.qkv(cells).chunk(3, dim=-1)
    size, places = channels // attention.heads, list(product(range(height), range(width)))
    table = attention.bias.reshape(2 * window - 1, 2 * window - 1, attention.heads)
    result = torch.zeros_like(cells)
    for row, column in places:
        seen = [
            (r, c) for r, c in places
            if (r - shift) // window == (row - shift) // window and (c - shift) // window == (column - shift) // window
        ]  # fmt: skip
        for head in range(attention.heads):
            own = slice(head * size, (head + 1) * size)
            bias = torch.stack([table[row - r + window - 1, column - c + window - 1, head] for r, c in seen])
            scores = torch.stack([q[row, column, own] @ k[r, c, own] / size**0.5 for r, c in seen]) + bias
            values = torch.stack([v[r, c, own] for r, c in seen])
            result[row, column, own] = scores.softmax(dim=0) @ values
    projected: Tensor = attention.project(result)
    return projected


@pytest.mark.parametrize("is_shifted", [False, True])
@pytest.mark.parametrize("size", [(6, 6), (5, 7), (2, 3)])
def test_a_block_attends_within_windows_as_a_slow_loop_does(is_shifted: bool, size: tuple[int, int]) -> None:
    block = ShiftedWindowBlock(16, is_shifted, SMALL_WINDOWS).double()
    nn.init.normal_(block.attention.bias)
    maps = torch.randn(2, 16, *size, dtype=torch.float64)
    answers = block(maps)
    for number, cells in enumerate(maps.permute(0, 2, 3, 1)):
        padded = torch.zeros(-(-size[0] // 3) * 3, -(-size[1] // 3) * 3, 16, dtype=torch.float64)
        padded[: size[0], : size[1]] = block.norm1(cells)
        attended = slowly_attended(block.attention, padded, 3, int(is_shifted))
        expected = cells + attended[: size[0], : size[1]]
        expected = expected + block.feed_forward(block.norm2(expected))
        torch.testing.assert_close(answers[number].permute(1, 2, 0), expected)


def test_a_dropped_branch_keeps_its_mean_and_is_dropped_for_whole_samples() -> None:
    branch = torch.ones(20_000, 2, 3)
    dropped = stochastic_depth(branch, 0.2)
    assert dropped.mean().item() == pytest.approx(1.0, abs=0.02)
    assert set(dropped.flatten(1).std(dim=1).tolist()) == {0.0}
    assert stochastic_depth(branch, 0.0) is branch


def test_the_encoder_halves_volumes() -> None:
    volumes = DualPathEncoder(SMALL_PATHS)(torch.randn(2, 16, 9, 8, 4))
    assert [tuple(v.shape) for v in volumes] == [
        (2, 16, 9, 8, 4), (2, 32, 5, 4, 2), (2, 32, 3, 2, 1), (2, 64, 2, 1, 1),
    ]  # fmt: skip


def slowly_sampled(values: Tensor, places: Tensor, weights: Tensor) -> Tensor:
    """Each reading by itself, from its eight voxels."""
    batch, queries, heads, levels, points, _ = places.shape
    result = torch.zeros(batch, queries, heads, values.shape[3], dtype=values.dtype)
    starts = [0, SHAPES[0][0] * SHAPES[0][1] * SHAPES[0][2]]
    ranges = (batch, queries, heads, levels, points)
    for b, q, h, level, p in product(*(range(n) for n in ranges)):
        shape = SHAPES[level]
        at = [float(places[b, q, h, level, p, 2 - axis]) * shape[axis] - 0.5 for axis in range(3)]
        for corner in product((0, 1), repeat=3):
            voxel = [floor(a) + c for a, c in zip(at, corner, strict=True)]
            if all(0 <= v < n for v, n in zip(voxel, shape, strict=True)):
                share = weights[b, q, h, level, p]
                for a, v in zip(at, voxel, strict=True):
                    share = share * (1.0 - abs(a - v))
                flat = starts[level] + (voxel[0] * shape[1] + voxel[1]) * shape[2] + voxel[2]
                result[b, q, h] += share * values[b, flat, h]
    return result.flatten(2)


def readings() -> tuple[Tensor, Tensor, Tensor]:
    """Values, places of which some lie outside, and weights."""
    values = torch.randn(2, 12 + 36, 2, 3, dtype=torch.float64)
    places = torch.rand(2, 4, 2, 2, 2, 3, dtype=torch.float64) * 1.4 - 0.2
    return values, places, torch.rand(2, 4, 2, 2, 2, dtype=torch.float64)


def test_volumes_are_sampled_as_a_slow_loop_does() -> None:
    values, places, weights = readings()
    expected = slowly_sampled(values, places, weights)
    torch.testing.assert_close(sample_volumes(values, SHAPES, places, weights), expected, rtol=1e-12, atol=1e-12)


def test_attention_begins_as_a_mean_of_voxels_one_to_four_steps_away() -> None:
    settings = DeformableSettings3D(channels=4, heads=4, levels=1, points=2)
    attention = DeformableAttention3D(settings)
    for layer in (attention.values, attention.project):
        nn.init.eye_(layer.weight)
    values = torch.randn(1, 7 * 7 * 7, 4)
    read = attention(values, voxel_places(((7, 7, 7),)), values, ((7, 7, 7),)).reshape(7, 7, 7, 4)
    volume = values.reshape(7, 7, 7, 4)
    # The first head's ray is (z, y, x) = (1, 0, ½): its last coordinate is half of a voxel along x.
    expected = (volume[3, 3, 4, 0] + volume[4, 3, 4, 0]) / 4 + volume[4, 3, 5, 0] / 2
    torch.testing.assert_close(read[3, 3, 3, 0], expected)


def test_positions_are_sines_and_cosines_of_each_axis_in_turn() -> None:
    positions = sine_positions((3, 4, 5), 24).reshape(3, 4, 5, 24)
    for axis, index, length in ((0, 1, 3), (1, 2, 4), (2, 3, 5)):
        phase = 2.0 * pi * (index + 1) / length
        for wave in range(4):
            angle = phase / 10_000.0 ** (2 * wave / 8)
            both = positions[1, 2, 3, 8 * axis + 2 * wave : 8 * axis + 2 * wave + 2]
            torch.testing.assert_close(both, torch.tensor([sin(angle), cos(angle)]), atol=1e-5, rtol=0.0)


def test_the_pixel_decoder_keeps_shapes() -> None:
    levels = tuple(torch.randn(2, c, n, n, m) for c, n, m in ((16, 8, 4), (32, 4, 2), (32, 2, 1), (64, 1, 1)))
    features, memories = PixelDecoder3D(SMALL_PIXELS)(levels)
    assert tuple(features.shape) == (2, 12, 8, 8, 4)
    assert [tuple(m.shape) for m in memories] == [(2, 12, 1, 1, 1), (2, 12, 2, 2, 1), (2, 12, 4, 4, 2)]


def test_the_mask_decoder_answers_at_first_and_after_each_layer() -> None:
    memories = tuple(torch.randn(2, 12, n, n, 1) for n in (1, 2, 4))
    predictions = MaskDecoder(SMALL_QUERIES)(torch.randn(2, 12, 8, 8, 2), memories)
    assert [tuple(p.classes.shape) for p in predictions] == [(2, 5, 5)] * 5
    assert [tuple(p.masks.shape) for p in predictions] == [(2, 5, 8, 8, 2)] * 5


def test_a_query_sees_only_where_its_mask_is() -> None:
    layer = MaskDecoderLayer(SMALL_QUERIES)
    queries, tokens, position = torch.randn(1, 5, 12), torch.randn(1, 8, 12), torch.randn(5, 12)
    hidden = torch.zeros(2, 5, 8, dtype=torch.bool)
    hidden[:, :, 3:] = True
    changed = tokens.clone()
    changed[:, 3:] += 1.0
    answers = [layer(queries, position, MemoryTokens(t, t), hidden) for t in (tokens, changed)]
    torch.testing.assert_close(answers[0], answers[1])
    changed[:, :3] += 1.0
    assert not torch.allclose(answers[0], layer(queries, position, MemoryTokens(changed, changed), hidden))


def test_a_mask_hides_what_it_does_not_cover_and_nothing_where_it_covers_nothing() -> None:
    masks = torch.full((1, 2, 4, 4, 2), -1.0)
    masks[0, 0, 3, 0, 1] = 2.0
    hidden = hidden_voxels(masks, (2, 2, 1))
    assert hidden.tolist() == [[[True, True, False, True], [False] * 4]]
