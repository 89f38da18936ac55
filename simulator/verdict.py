"""The agreement of labels with the truth of a simulated world.

**Conventions.** Predicted drivable = label 1 (T) or 2 (P); predicted not drivable = 3 (N). Counts cover occupied voxels
(label > 0) that the truth judges, over all frames; ratios are computed once at the end and are None without support.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.truth import DRIVABLE, NOT_DRIVABLE
from stone.geometry.se3 import Array

Place = tuple[tuple[float, float, float], float]
# The lowest corner of the paper's grid and its voxel, metres.
PAPER: Place = ((-25.6, -25.6, -2.0), 0.2)


@dataclass(frozen=True)
class LabelVerdict:
    """Counts of judged voxels: drivable or not in truth × labelled drivable or not."""

    frames: int
    drivable_kept: int
    drivable_lost: int
    blocked_kept: int
    blocked_lost: int

    @property
    def iou(self) -> float | None:
        return _ratio(self.drivable_kept, self.drivable_kept + self.drivable_lost + self.blocked_kept)

    @property
    def precision(self) -> float | None:
        return _ratio(self.drivable_kept, self.drivable_kept + self.blocked_kept)

    @property
    def recall(self) -> float | None:
        return _ratio(self.drivable_kept, self.drivable_kept + self.drivable_lost)

    @property
    def danger(self) -> float | None:
        """The share of non-drivable voxels that is labelled drivable."""
        return _ratio(self.blocked_kept, self.blocked_kept + self.blocked_lost)

    @property
    def everything_iou(self) -> float | None:
        """The score of labelling every occupied voxel traversable: the drivable share."""
        drivable = self.drivable_kept + self.drivable_lost
        return _ratio(drivable, drivable + self.blocked_kept + self.blocked_lost)

    def as_record(self) -> dict[str, float | int | None]:
        ratios = {name: getattr(self, name) for name in ("iou", "precision", "recall", "danger", "everything_iou")}
        return asdict(self) | ratios


def judge_semantics(
    semantics: NDArray[np.uint8],
    judge: Callable[[Array], NDArray[np.uint8]],
    map_from_ego: Array,
    place: Place = PAPER,
) -> NDArray[np.int64]:
    """Return (4,) counts of one frame whose grid lies at `place`: drivable kept and lost, blocked kept and lost."""
    index = np.argwhere(semantics > 0)
    label = semantics[tuple(index.T)]
    low_m, voxel_m = place
    centres = (index + 0.5) * voxel_m + np.asarray(low_m)
    verdict = judge(centres @ map_from_ego[:3, :3].T + map_from_ego[:3, 3])
    is_kept = label < 3
    return np.array(
        [
            np.count_nonzero((verdict == truth) & (is_kept == kept))
            for truth in (DRIVABLE, NOT_DRIVABLE)
            for kept in (True, False)
        ]
    )


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
