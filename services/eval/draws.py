"""Resampled ratios of a submission: what every interval, paired comparison and rank interval is read from.

**Conventions.** Draws are float32 [draw, 5], columns `stone.metric.RATIOS`, NaN where undefined: `block` from blocks of
frames inside sequences, `sequence` from whole sequences. The random numbers depend on the sequences' lengths alone, so
row k of two submissions to one ground truth is the same resampling: their differences are paired.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.runtime.npz import npz_bytes
from stone.bootstrap import BootstrapOptions, block_draws, interval, sequence_draws
from stone.confusion import Counts, ratios
from stone.metric import METRIC_VERSION, RATIOS

OPTIONS = BootstrapOptions(draws=4000, block_frames=200, seed=0)

Drawn = NDArray[np.float32]
Bounds = list[float]  # as JSON has it


@dataclass(frozen=True, eq=False)
class Draws:
    """`block` [4000, 5]; `sequence` [E, 5], every combination of sequences where there are at most 4000."""

    block: Drawn
    sequence: Drawn

    def npz(self) -> bytes:
        """The same draws, the same bytes."""
        return npz_bytes({"block": self.block, "sequence": self.sequence})


def ratio_draws(confusions: Counts, frames_of_sequence: Sequence[int], metric: str = METRIC_VERSION) -> Draws:
    """Of confusions [F, ring, 4, 4] in time order inside each sequence.

    Raises `ShapeError` where lengths and frames disagree or there are none, and `UnknownMetricError`.
    """
    by_frame = confusions.sum(axis=1, dtype=np.int64)
    return Draws(
        ratios(block_draws(by_frame, frames_of_sequence, OPTIONS), metric).astype(np.float32),
        ratios(sequence_draws(by_frame, frames_of_sequence, OPTIONS), metric).astype(np.float32),
    )


def intervals_of(draws: Draws, frames_of_sequence: Sequence[int]) -> dict[str, dict[str, Bounds | None]]:
    """Central percentile intervals [low, high] by kind and ratio.

    None where a draw leaves the ratio undefined, and where resampling can change nothing, which is no certainty: one
    sequence only, or none longer than a block.
    """
    has_blocks, has_sequences = max(frames_of_sequence) > OPTIONS.block_frames, len(frames_of_sequence) > 1
    kinds = {"block": (draws.block, has_blocks), "sequence": (draws.sequence, has_sequences)}
    return {
        kind: {name: _bounds(values) if is_known else None for name, values in zip(RATIOS, drawn.T, strict=True)}
        for kind, (drawn, is_known) in kinds.items()
    }


def _bounds(values: Drawn) -> Bounds | None:
    found = interval(values, OPTIONS)
    return list(found) if found else None
