"""Voxel losses are the official formulas, written out voxel by voxel; a coarse cell is what its voxels say."""

from collections import Counter
from math import log
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.batch import IGNORED
from baselines.losses.voxels import coarse_labels, cross_entropy, geometric_scale, lovasz_softmax, semantic_scale

LOSSES = (cross_entropy, semantic_scale, geometric_scale, lovasz_softmax)


def scene(seed: int, *, classes: int = 4, ignored: float = 0.2) -> tuple[Tensor, Tensor]:
    """Float64 logits (2, 4, 4, 3, 5) and labels of the first `classes`."""
    random = torch.Generator().manual_seed(seed)
    logits = torch.randn(2, 4, 4, 3, 5, generator=random, dtype=torch.float64) * 2
    labels = torch.randint(classes, (2, 4, 3, 5), generator=random).to(torch.uint8)
    labels[torch.rand(2, 4, 3, 5, generator=random) < ignored] = IGNORED
    return logits, labels


def counted_voxels(logits: Tensor, labels: Tensor) -> tuple[np.ndarray[Any, Any], list[int]]:
    """Probabilities (M, 4) and classes, in numpy."""
    rows = logits.permute(0, 2, 3, 4, 1).reshape(-1, 4).numpy()
    kept = [i for i, label in enumerate(labels.flatten().tolist()) if label != IGNORED]
    scores = np.exp(rows[kept])
    return scores / scores.sum(axis=1, keepdims=True), [int(labels.flatten()[i]) for i in kept]


def test_cross_entropy_is_the_weighted_mean_of_what_each_voxel_lacks() -> None:
    logits, labels = scene(0)
    weights = [0.06, 0.125, 0.085, 0.08]
    p, classes = counted_voxels(logits, labels)
    terms = [-weights[c] * log(p[i, c]) for i, c in enumerate(classes)]
    expected = sum(terms) / sum(weights[c] for c in classes)
    assert cross_entropy(logits, labels, torch.tensor(weights, dtype=torch.float64)).item() == pytest.approx(expected)


@pytest.mark.parametrize("classes", [1, 2, 4])
def test_semantic_scale_is_the_official_sum_over_classes_that_occur(classes: int) -> None:
    logits, labels = scene(1, classes=classes)
    p, truth = counted_voxels(logits, labels)
    loss = 0.0
    for c in set(truth):
        is_c = [t == c for t in truth]
        hits = sum(p[i, c] for i, so in enumerate(is_c) if so)
        loss -= log(hits / p[:, c].sum()) + log(hits / sum(is_c))
        if not all(is_c):
            rejected = sum(1 - p[i, c] for i, so in enumerate(is_c) if not so)
            loss -= log(rejected / (len(is_c) - sum(is_c)))
    assert semantic_scale(logits, labels).item() == pytest.approx(loss / len(set(truth)), rel=1e-9)


def test_geometric_scale_is_the_official_sum_of_three_terms() -> None:
    logits, labels = scene(2)
    p, truth = counted_voxels(logits, labels)
    occupied = np.array([t != 0 for t in truth], dtype=float)
    hits = float((occupied * (1 - p[:, 0])).sum())
    expected = -log(hits / ((1 - p[:, 0]).sum() + 1e-5)) - log(hits / (occupied.sum() + 1e-5))
    expected -= log(((1 - occupied) * p[:, 0]).sum() / ((1 - occupied).sum() + 1e-5))
    assert geometric_scale(logits, labels).item() == pytest.approx(expected, rel=1e-9)


def test_lovasz_softmax_is_the_officials_sorted_sum() -> None:
    logits, labels = scene(3)
    p, truth = counted_voxels(logits, labels)
    losses = []
    for c in sorted(set(truth)):
        errors = [abs((t == c) - p[i, c]) for i, t in enumerate(truth)]
        order = sorted(range(len(errors)), key=lambda i: -errors[i])
        total, before, loss = sum(t == c for t in truth), 0.0, 0.0
        for k in range(len(order)):
            wrong = order[: k + 1]
            missed = sum(truth[i] == c for i in wrong)
            jaccard = 1 - (total - missed) / (total + len(wrong) - missed)
            loss += errors[order[k]] * (jaccard - before)
            before = jaccard
        losses.append(loss)
    assert lovasz_softmax(logits, labels).item() == pytest.approx(np.mean(losses), rel=1e-9)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("classes", [1, 3])
def test_gradients_are_those_of_differences(loss: Any, classes: int) -> None:
    logits, labels = scene(4, classes=classes)
    logits, labels = logits[:1, :, :2, :2, :3].clone().requires_grad_(), labels[:1, :2, :2, :3]
    assert torch.autograd.gradcheck(lambda scores: loss(scores, labels), (logits,), eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("loss", LOSSES)
def test_what_is_ignored_moves_nothing(loss: Any) -> None:
    logits, labels = scene(5)
    other = torch.where((labels == IGNORED)[:, None], logits + torch.randn(4, 1, 1, 1), logits)
    assert torch.equal(loss(logits, labels), loss(other, labels))


@pytest.mark.parametrize("loss", LOSSES)
def test_nothing_counted_costs_nothing_and_has_a_gradient_of_zeros(loss: Any) -> None:
    logits = torch.randn(1, 4, 2, 2, 2, requires_grad=True)
    value = loss(logits, torch.full((1, 2, 2, 2), IGNORED, dtype=torch.uint8))
    value.backward()
    assert value.item() == 0
    assert not logits.grad.any()


@pytest.mark.parametrize("loss", LOSSES)
def test_voxels_one_by_one_cost_as_much_as_in_their_lattice(loss: Any) -> None:
    logits, labels = scene(6)
    assert torch.allclose(loss(logits.movedim(1, -1).reshape(-1, 4), labels.flatten()), loss(logits, labels))


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("is_right", [True, False])
def test_certainty_costs_nothing_if_right_and_stays_finite_if_wrong(loss: Any, is_right: bool) -> None:
    _, labels = scene(7, ignored=0)
    told = labels.long() if is_right else (labels.long() + 1) % 4
    logits = (torch.nn.functional.one_hot(told, 4).movedim(-1, 1).float() * 300).requires_grad_()
    value = loss(logits, labels)
    value.backward()
    assert logits.grad.isfinite().all()
    assert value.item() == pytest.approx(0, abs=1e-5) if is_right else 0.9 < value.item() < 1000


@pytest.mark.parametrize("loss", LOSSES)
def test_half_precision_logits_are_counted_in_float32(loss: Any) -> None:
    logits, labels = scene(8)
    half = logits.bfloat16()
    assert loss(half, labels).dtype == torch.float32
    assert loss(half, labels).item() == pytest.approx(loss(half.double(), labels).item(), rel=1e-5)


def said_by(voxels: list[int]) -> int:
    """The same, one cell at a time."""
    occupied = Counter(v for v in voxels if v not in (0, IGNORED))
    if occupied:
        return min(occupied, key=lambda c: (-occupied[c], c))
    return IGNORED if IGNORED in voxels else 0


@pytest.mark.parametrize("ratio", [1, 2, 4])
def test_a_cell_is_its_most_frequent_occupied_class(ratio: int) -> None:
    random = torch.Generator().manual_seed(0)
    draw = torch.multinomial(torch.tensor([20.0, 1, 1, 1, 4]), 2 * 8 * 8 * 4, replacement=True, generator=random)
    labels = torch.tensor([0, 1, 2, 3, IGNORED], dtype=torch.uint8)[draw].view(2, 8, 8, 4)
    coarse = coarse_labels(labels, ratio)
    assert coarse.shape == (2, 8 // ratio, 8 // ratio, 4 // ratio)
    for b, x, y, z in torch.cartesian_prod(*(torch.arange(n) for n in coarse.shape)).tolist():
        cell = labels[b, x * ratio :, y * ratio :, z * ratio :][:ratio, :ratio, :ratio].flatten().tolist()
        assert coarse[b, x, y, z].item() == (said_by(cell) if ratio > 1 else cell[0])
