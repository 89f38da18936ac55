"""Influence of each frame on a ratio of sums: what its counts move the ratio by, to first order.

    r = g(C), C = Σ_f c_f;   z_f = ∇g(C) · c_f,   Σ_f z_f = 0

for a ratio does not change when all counts grow alike. The wander of the z along a sequence is the ratio's uncertainty.

**Conventions.** Confusions are (F, 4, 4) counts by frame; influences (F, 5) float64, columns
`stone.scoring.metric.RATIOS`, NaN where the ratio is undefined. Of a − b they are z_a − z_b.

Source: the influence function, Hampel (1974); as the linearisation of a ratio estimator, Woodruff (1971).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import Counts, unions_and_hits
from stone.scoring.metric import METRIC_VERSION, RATIOS

OCCUPIED, MEAN = RATIOS.index("iou_occ"), RATIOS.index("miou")
CLASS_COLUMNS = tuple(RATIOS.index(name) for name in ("iou_t", "iou_p", "iou_n"))

Influences = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameInfluences:
    """`of_frame` (F, 5) the influences; `weight` (F, 5) ≥ 0 the share of the ratio's union that a frame holds."""

    of_frame: Influences
    weight: Influences


def frame_influences(confusions: Counts, metric: str = METRIC_VERSION) -> FrameInfluences:
    """Of confusions (F, 4, 4). Raises `ShapeError` for other shapes or no frame, and `UnknownMetricError`."""
    if confusions.ndim != 3 or not len(confusions):
        raise ShapeError("confusions", confusions.shape, "(F, 4, 4) with at least one frame")
    unions, hits = (counts.astype(np.float64) for counts in unions_and_hits(confusions, metric))
    union, hit = unions.sum(axis=0), hits.sum(axis=0)
    whole = np.where(union > 0, union, np.nan)
    of_frame, weight = (hits - unions * (hit / whole)) / whole, unions / whole
    return FrameInfluences(_with_mean(of_frame), _with_mean(weight))


def _with_mean(of_parts: Influences) -> Influences:
    """(F, 5) of occupancy and the three classes (F, 4): the mean has the mean influence of its classes."""
    columns = np.empty((len(of_parts), len(RATIOS)))
    columns[:, [OCCUPIED, *CLASS_COLUMNS]] = of_parts
    columns[:, MEAN] = of_parts[:, 1:].mean(axis=1)
    return columns
