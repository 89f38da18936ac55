"""Scores of a model on frames that it was not trained on, by the platform's metric."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from baselines.batch import moved
from baselines.data import FrameDataset
from baselines.metrics import confusion_of, scores_of
from baselines.models.occupancy_model import OccupancyModel


def scores_on(
    model: OccupancyModel[Any], dataset: FrameDataset, targets: Sequence[int], where: tuple[torch.device, str]
) -> dict[str, float | None]:
    """Ratios over all observed voxels of the frames `targets`; the model is left in training mode if it was in it."""
    device, precision = where
    whole, was_training = np.zeros((4, 4), np.int64), model.training
    model.eval()
    with torch.inference_mode():
        for index in targets:
            batch = moved(dataset[0, index], device)
            with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16"):
                outputs = model(batch)
            if batch.labels is not None:
                whole += confusion_of(model.logits(outputs, batch), batch.labels)
    model.train(was_training)
    return scores_of(whole)
