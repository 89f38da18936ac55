"""Signatures of scores: the conditions under which scores are comparable, in one line (after sacrebleu)."""

from dataclasses import dataclass

from stone.scoring.metric import CLASS_NAMES, METRIC_VERSION
from stone_base.label_grid import PAPER, LabelGrid


@dataclass(frozen=True)
class Signature:
    """A board never mixes signatures. `ground_truth` is the hash of all evaluated data."""

    ground_truth: str
    mask: str
    metric: str = METRIC_VERSION
    grid: LabelGrid = PAPER

    def __str__(self) -> str:
        """Return the line; `truth` is the first 16 hex digits of the hash."""
        grid = "x".join(map(str, self.grid.shape)) + f"@{self.grid.voxel_m}m"
        if self.grid.min_m != PAPER.min_m:
            grid += f"[{','.join(f'{low_m:g}' for low_m in self.grid.min_m)}]"
        classes = ",".join(f"{index}={name}" for index, name in enumerate(CLASS_NAMES))
        return f"metric:{self.metric}|truth:{self.ground_truth[:16]}|mask:{self.mask}|grid:{grid}|classes:{classes}"
