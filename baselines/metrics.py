"""The platform's own metric of predictions while training: confusions add, ratios are read once.

**Conventions.** As `stone.scoring.confusion`: rows ground truth, columns prediction. Which voxels count is the row's
`counted`, as a benchmark's mask has it.
"""

from math import isnan

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.batch import IGNORED
from baselines.models.occupancy_model import likeliest
from stone.scoring.confusion import ratios
from stone.scoring.metric import CLASSES, RATIOS


def confusion_of(logits: Tensor, labels: Tensor) -> NDArray[np.int64]:
    """(4, 4) counts of logits (B, 4, X, Y, Z) against labels (B, X, Y, Z)."""
    return class_confusion(likeliest(logits.detach()), labels)


def class_confusion(predicted: Tensor, labels: Tensor) -> NDArray[np.int64]:
    """(4, 4) counts of classes (...) against labels (...), uint8."""
    counted = labels != IGNORED
    cells = labels[counted].long() * CLASSES + predicted[counted]
    counts = torch.bincount(cells, minlength=CLASSES * CLASSES).reshape(CLASSES, CLASSES)
    return counts.cpu().numpy().astype(np.int64)


def scores_of(confusion: NDArray[np.int64]) -> dict[str, float | None]:
    """Ratios by name (`stone.scoring.metric.RATIOS`), None where a class is in neither."""
    return {
        name: None if isnan(value) else value for name, value in zip(RATIOS, ratios(confusion).tolist(), strict=True)
    }
