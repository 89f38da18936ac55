"""The metric while training is the platform's own: counts add, what is ignored is not counted."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.batch import Batch
from baselines.data import FrameDataset, FrameRequest
from baselines.evaluation import scores_on
from baselines.inputs import InputConfig
from baselines.lattice import VoxelLattice
from baselines.metrics import confusion_of
from baselines.models.occupancy_model import OccupancyModel, likeliest
from stone.scoring.metric import RATIOS
from tests.baselines.test_data import RECORDS, SMALL, Frames

CPU = (torch.device("cpu"), "float32")


def one_hot(labels: Tensor) -> Tensor:
    return torch.nn.functional.one_hot(labels.long().clamp(max=3), 4).movedim(-1, 1).float()


class Oracle(OccupancyModel[Tensor]):
    """Answers the labels that it is given, or free."""

    def __init__(self, knows: bool = True) -> None:
        super().__init__()
        self.lattice, self.modality, self.knows = SMALL, "L", knows

    def forward(self, batch: Batch) -> Tensor:
        assert not self.training
        return one_hot(batch.labels * self.knows)

    def losses(self, outputs: Tensor, batch: Batch) -> dict[str, Tensor]:
        return {}

    def logits(self, outputs: Tensor, batch: Batch) -> Tensor:
        return outputs


def dataset(**changes: Any) -> FrameDataset:
    return FrameDataset(Frames(RECORDS), FrameRequest(InputConfig("L"), SMALL, **changes))


def test_a_confusion_is_a_loop_over_voxels() -> None:
    random = np.random.default_rng(1)
    labels = random.choice(np.array([0, 1, 2, 3, 255], np.uint8), (2, 4, 3, 5))
    logits = torch.from_numpy(random.normal(size=(2, 4, 4, 3, 5)))
    wanted = np.zeros((4, 4), np.int64)
    for frame, x, y, z in np.ndindex(labels.shape):
        if labels[frame, x, y, z] != 255:
            wanted[labels[frame, x, y, z], int(logits[frame, :, x, y, z].argmax())] += 1
    assert np.array_equal(confusion_of(logits, torch.from_numpy(labels)), wanted)


def test_of_equal_logits_the_first_class_is_taken() -> None:
    logits = torch.from_numpy(np.random.default_rng(2).integers(0, 3, (2, 4, 5, 6, 7))).float()
    logits[0, :, 0, 0] = -torch.inf
    classes = likeliest(logits)
    assert classes.dtype == torch.uint8
    assert np.array_equal(classes.numpy(), logits.numpy().argmax(axis=1))


def test_true_predictions_score_one_and_free_ones_nothing() -> None:
    targets = range(3)
    assert scores_on(Oracle().train(), dataset(), targets, CPU) == dict.fromkeys(RATIOS, 1.0)
    assert scores_on(Oracle(knows=False), dataset(), targets, CPU)["miou"] == 0


@pytest.mark.parametrize("trains", [True, False])
def test_a_model_is_left_in_the_mode_it_was_in(trains: bool) -> None:
    model = Oracle().train(trains)
    scores_on(model, dataset(), [0], CPU)
    assert model.training == trains


def test_what_nobody_observed_counts_as_free_or_not_at_all() -> None:
    lattice = replace(VoxelLattice(), shape=(16, 16, 8))  # a corner of the grid, of which nine rows were not observed
    request = FrameRequest(InputConfig("L"), lattice)
    both = [
        FrameDataset(Frames(RECORDS), replace(request, counted=counted))[0, 0].labels for counted in ("all", "observed")
    ]
    assert all(labels is not None for labels in both)
    everywhere, observed = (labels[0] for labels in both if labels is not None)
    assert not everywhere[:9].any()
    assert (observed[:9] == 255).all()
    assert torch.equal(everywhere[9:], observed[9:])
