"""Frames of a dataset in torch's own loader, by workers that start anew.

Catches alone a dataset whose frames a worker cannot read.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from stone_client.devkit import Frame, open_dataset
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip


def in_map(frame: Frame) -> dict[str, Any]:
    """Poses and sweeps, of which every frame has another number of returns."""
    return {"token": frame.token, "map_from_ego": frame.map_from_ego, "sweep": frame.sweep}


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_two_workers_load_what_the_frames_are(tmp_path: Path, start: str) -> None:
    dataset = open_dataset(write_released_zip(tmp_path / "STONE.zip", ReleasedDataset(scenes=2, frames=3)))
    loading = {"num_workers": 2, "multiprocessing_context": start}
    batches = list(DataLoader(dataset.as_torch(), batch_size=2, **loading))
    assert [len(batch["token"]) for batch in batches] == [2, 2, 2]
    for frame, (token, semantics, observed) in zip(dataset, _one_by_one(batches), strict=True):
        assert (token, semantics.dtype, observed.dtype) == (frame.token, torch.uint8, torch.bool)
        assert np.array_equal(semantics.numpy(), frame.semantics)
        assert np.array_equal(observed.numpy(), frame.observed)
    for frame, item in zip(dataset, DataLoader(dataset.as_torch(in_map), batch_size=None, **loading), strict=True):
        assert np.array_equal(item["sweep"].numpy(), frame.sweep)
        assert np.array_equal(item["map_from_ego"].numpy(), frame.map_from_ego)


def _one_by_one(batches: list[dict[str, Any]]) -> Iterator[tuple[str, torch.Tensor, torch.Tensor]]:
    for batch in batches:
        yield from zip(batch["token"], batch["semantics"], batch["observed"], strict=True)
