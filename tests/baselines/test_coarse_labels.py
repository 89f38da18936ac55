"""A coarse cell is labelled by what its voxels say."""

from collections import Counter

import pytest
import torch

from baselines.batch import IGNORED
from baselines.losses.coarse_labels import coarse_labels


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


def test_one_occupied_voxel_occupies_its_cell() -> None:
    labels = torch.zeros(1, 4, 4, 4, dtype=torch.uint8)
    labels[0, 3, 2, 1] = 2
    assert coarse_labels(labels, 4).item() == 2
