"""Bootstrap replicates of a submission's ratios, from which all intervals and rank intervals are computed.

**Conventions.** Replicates are float32 [replicate, 5], columns `stone.scoring.metric.RATIOS`, NaN where undefined:
`block` from blocks of frames inside sequences, `sequence` from whole sequences. The random numbers depend on the
sequences' lengths alone, so row k of two submissions to one ground truth is the same resampling: their differences are
paired.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.scoring.bootstrap import BootstrapOptions, block_replicates, interval, sequence_replicates
from stone.scoring.confusion import Counts, ratios
from stone.scoring.metric import METRIC_VERSION, RATIOS
from stone_files.npz import npz_bytes

OPTIONS = BootstrapOptions(replicates=4000, block_frames=200, seed=0)

Replicates = NDArray[np.float32]
Bounds = list[float]  # as JSON has it


@dataclass(frozen=True, eq=False)
class ScoreReplicates:
    """`block` [4000, 5]; `sequence` [E, 5], every combination of sequences where there are at most 4000."""

    block: Replicates
    sequence: Replicates

    def npz(self) -> bytes:
        """The same replicates, the same bytes."""
        return npz_bytes({"block": self.block, "sequence": self.sequence})


def ratio_replicates(
    confusions: Counts, frames_of_sequence: Sequence[int], metric: str = METRIC_VERSION
) -> ScoreReplicates:
    """Of confusions [F, ring, 4, 4] in time order inside each sequence.

    Raises `ShapeError` where lengths and frames disagree or there are none, and `UnknownMetricError`.
    """
    by_frame = confusions.sum(axis=1, dtype=np.int64)
    return ScoreReplicates(
        ratios(block_replicates(by_frame, frames_of_sequence, OPTIONS), metric).astype(np.float32),
        ratios(sequence_replicates(by_frame, frames_of_sequence, OPTIONS), metric).astype(np.float32),
    )


def intervals_of(replicates: ScoreReplicates, frames_of_sequence: Sequence[int]) -> dict[str, dict[str, Bounds | None]]:
    """Central percentile intervals [low, high] by kind and ratio.

    None where a replicate leaves the ratio undefined, and where resampling can change nothing, which is no certainty:
    one sequence only, or none longer than a block.
    """
    has_blocks, has_sequences = max(frames_of_sequence) > OPTIONS.block_frames, len(frames_of_sequence) > 1
    kinds = {"block": (replicates.block, has_blocks), "sequence": (replicates.sequence, has_sequences)}
    return {
        kind: {name: _bounds(values) if is_known else None for name, values in zip(RATIOS, of_kind.T, strict=True)}
        for kind, (of_kind, is_known) in kinds.items()
    }


def _bounds(values: Replicates) -> Bounds | None:
    found = interval(values, OPTIONS)
    return list(found) if found else None
