"""Deformable attention agrees with a loop over queries, heads, levels and points, and so do its gradients."""

from math import floor

import pytest
import torch

from baselines.layers.deformable_attention import SamplingHead, by_head, deformable_attention

torch.set_num_threads(1)
BATCH, QUERIES, HEADS, CHANNELS, POINTS = 2, 3, 2, 3, 2
SIZES = ((4, 5), (2, 3))


def inputs_of(seed: int, margin: float = 0.3) -> tuple[list[torch.Tensor], torch.Tensor, torch.Tensor]:
    """Maps, places up to `margin` outside of them, and weights, float64."""
    generator = torch.Generator().manual_seed(seed)
    maps = [torch.randn(BATCH, HEADS, CHANNELS, *size, dtype=torch.float64, generator=generator) for size in SIZES]
    shape = (BATCH, QUERIES, HEADS, len(SIZES), POINTS)
    places = torch.rand(*shape, 2, dtype=torch.float64, generator=generator) * (1 + 2 * margin) - margin
    return maps, places, torch.rand(*shape, dtype=torch.float64, generator=generator)


def bilinear(values: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """(c,) of a map (c, rows, columns), pixel by pixel; pixels outside are 0."""
    rows, columns = values.shape[1:]
    u, v = place[0].item() * columns - 0.5, place[1].item() * rows - 0.5
    answer = torch.zeros(len(values), dtype=values.dtype)
    for row in (floor(v), floor(v) + 1):
        for column in (floor(u), floor(u) + 1):
            if 0 <= row < rows and 0 <= column < columns:
                answer = answer + (1 - abs(v - row)) * (1 - abs(u - column)) * values[:, row, column]
    return answer


def slow_attention(maps: list[torch.Tensor], places: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    batch, queries, heads, levels, points = weights.shape
    answer = torch.zeros(batch, queries, heads, maps[0].shape[2], dtype=weights.dtype)
    for at in torch.cartesian_prod(*(torch.arange(n) for n in (batch, queries, heads, levels, points))).tolist():
        frame, query, head, level, _ = at
        answer[frame, query, head] += weights[tuple(at)] * bilinear(maps[level][frame, head], places[tuple(at)])
    return answer.flatten(2)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_sum_over_levels_and_points_of_what_bilinear_sampling_finds(seed: int) -> None:
    maps, places, weights = inputs_of(seed)
    torch.testing.assert_close(deformable_attention(maps, places, weights), slow_attention(maps, places, weights))


def test_far_outside_it_finds_nothing() -> None:
    maps, places, weights = inputs_of(2)
    for far in (-2.0, 3.0, 1e30):
        assert not deformable_attention(maps, torch.full_like(places, far), weights).any()


def test_no_queries_have_no_answers_and_yet_a_gradient_of_zeros() -> None:
    maps, places, weights = inputs_of(3)
    maps[0].requires_grad_()
    answer = deformable_attention(maps, places[:, :0], weights[:, :0])
    assert answer.shape == (BATCH, 0, HEADS * CHANNELS)
    answer.sum().backward()
    assert not maps[0].grad.any()


def test_it_computes_in_float32_inside_autocast() -> None:
    maps, places, weights = inputs_of(4)
    narrow = [level.float() for level in maps]
    with torch.autocast("cpu", torch.bfloat16):
        found = deformable_attention(narrow, places.float(), weights.float())
    assert found.dtype == torch.float32
    torch.testing.assert_close(found.double(), slow_attention(maps, places, weights), rtol=1e-4, atol=1e-5)


def test_a_new_head_looks_along_a_ring_with_equal_scores_whatever_it_is_asked() -> None:
    heads, groups, points = 8, 3, 4
    sampling = SamplingHead(16, (heads, groups, points))
    offsets, scores = sampling(torch.randn(5, 16))
    assert not scores.any()
    torch.testing.assert_close(offsets.abs().amax(dim=-1), torch.arange(1.0, 5.0).expand(5, heads, groups, points))
    torch.testing.assert_close(
        offsets[:, 2], torch.tensor([0.0, 1.0]) * torch.arange(1.0, 5.0)[:, None].expand(5, 3, 4, 1)
    )
    torch.testing.assert_close(offsets[0].sum(dim=0), torch.zeros(groups, points, 2), atol=1e-5, rtol=0)


def test_heads_are_consecutive_channels() -> None:
    values = torch.arange(6.0)[:, None, None].expand(6, 2, 2)
    assert by_head(values, 3)[:, :, 0, 0].tolist() == [[0, 1], [2, 3], [4, 5]]
