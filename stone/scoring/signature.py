"""Signatures of scores: what makes two of them comparable, in one line printed with each (after sacrebleu)."""

from dataclasses import dataclass

from stone.labels.grid import GRID_SHAPE
from stone.labels.voxels import VOXEL_M
from stone.scoring.metric import CLASS_NAMES, METRIC_VERSION


@dataclass(frozen=True)
class Signature:
    """A board never mixes signatures. `ground_truth` is the hash of everything that was evaluated."""

    ground_truth: str
    mask: str
    metric: str = METRIC_VERSION

    def __str__(self) -> str:
        """`truth` is the first 16 hex digits of the hash of everything that was evaluated."""
        grid = "x".join(map(str, GRID_SHAPE)) + f"@{VOXEL_M}m"
        classes = ",".join(f"{index}={name}" for index, name in enumerate(CLASS_NAMES))
        return f"metric:{self.metric}|truth:{self.ground_truth[:16]}|mask:{self.mask}|grid:{grid}|classes:{classes}"
