"""The platform's own metric of predictions in training: confusions are summed, ratios are computed once.

**Conventions.** As in `stone.scoring.confusion`: rows ground truth, columns prediction. The row's `counted` selects the
voxels, like a benchmark's mask.
"""

import math
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.batch import IGNORED, Batch
from baselines.models.occupancy_model import OccupancyModel, likeliest
from baselines.row_config import TrainingConfig
from stone.scoring.confusion import ratios
from stone.scoring.metric import CLASSES, RATIOS


def confusion_of(logits: Tensor, labels: Tensor) -> NDArray[np.int64]:
    """Return counts (4, 4) of logits (B, 4, X, Y, Z) against labels (B, X, Y, Z)."""
    return class_confusion(likeliest(logits.detach()), labels)


def class_confusion(predicted: Tensor, labels: Tensor) -> NDArray[np.int64]:
    """Return counts (4, 4) of classes (...) against labels (...), uint8."""
    counted = labels != IGNORED
    cells = labels[counted].long() * CLASSES + predicted[counted]
    counts = torch.bincount(cells, minlength=CLASSES * CLASSES).reshape(CLASSES, CLASSES)
    return counts.cpu().numpy().astype(np.int64)


def scores_of(confusion: NDArray[np.int64]) -> dict[str, float | None]:
    """Return ratios by name (`stone.scoring.metric.RATIOS`), None for a class that occurs in neither."""
    return {
        name: None if isnan(value) else value for name, value in zip(RATIOS, ratios(confusion).tolist(), strict=True)
    }


# One training step: losses of a batch, gradients, and AdamW under a warmed-up cosine. Only `forward` runs in bfloat16,
# losses in float32 (`occupancy_model.py`). Source: AdamW, Loshchilov and Hutter (2019); the schedule and clipping of
# OpenOccupancy's configurations.


LEAST_RATE_RATIO = 1e-3
FIRST_RATE_RATIO = 1 / 3


class BatchLosses(nn.Module):
    """A model as the minimised function, for DistributedDataParallel."""

    def __init__(self, model: OccupancyModel[Any], precision: str) -> None:
        super().__init__()
        self.model, self.precision = model, precision

    def forward(self, batch: Batch, with_logits: bool = False) -> tuple[dict[str, Tensor], Tensor | None]:
        """Return the terms of the loss by name, with `with_logits` also the logits for the metric."""
        with torch.autocast(batch.device.type, torch.bfloat16, enabled=self.precision == "bfloat16"):
            outputs = self.model(batch)
        terms = self.model.losses(outputs, batch)
        if not with_logits:
            return terms, None
        with torch.no_grad():
            return terms, self.model.logits(outputs, batch)


@dataclass(frozen=True)
class RateSchedule:
    """The learning rate of a run of `steps` steps."""

    config: TrainingConfig
    steps: int

    def ratio(self, step: int) -> float:
        """Return the share of the full rate at the step with this number, from 0."""
        warmup = min(self.config.warmup_steps, max(self.steps // 5, 1))
        if step < warmup:
            return FIRST_RATE_RATIO + (1 - FIRST_RATE_RATIO) * step / warmup
        along = min((step - warmup) / max(self.steps - warmup, 1), 1.0)
        return LEAST_RATE_RATIO + (1 - LEAST_RATE_RATIO) * (1 + math.cos(math.pi * along)) / 2


def build_optimizer(model: nn.Module, config: TrainingConfig) -> torch.optim.AdamW:
    """Return AdamW; biases and norms do not decay, a backbone has its own rate."""
    groups = dict[tuple[bool, bool], list[nn.Parameter]]()
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            groups.setdefault((parameter.dim() > 1, "backbone" in name), []).append(parameter)
    described = [
        {
            "params": parameters,
            "weight_decay": config.weight_decay if decays else 0.0,
            "scale": config.backbone_rate_ratio if is_backbone else 1.0,
        }
        for (decays, is_backbone), parameters in groups.items()
    ]
    return torch.optim.AdamW(described, lr=config.learning_rate)


def take_step(parameters: list[nn.Parameter], optimizer: torch.optim.Optimizer, rate: float, clip_norm: float) -> float:
    """Clip, step and clear; return the gradients' norm before clipping. If it is not finite, no step is made."""
    norm = float(nn.utils.clip_grad_norm_(parameters, clip_norm))
    if not math.isfinite(norm):
        return norm
    for group in optimizer.param_groups:
        group["lr"] = rate * group["scale"]
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
    return norm
