"""A range of a submission's frames looked at, and the join of all ranges: what every scoring is made of.

**Conventions.** What is wrong with the archive as a whole is known when it is opened and not told again by a range.
"""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.eval.counting import TruthOf, count_range
from stone_submissions.archive import SubmissionZip
from stone_submissions.validation import THREADS, Progress, check_range, silent
from stone_submissions.verdict import Validation, verdict
from stone_submissions.verdict_record import merged


@dataclass(frozen=True, eq=False)
class Counts:
    """Of F frames: `confusions` [F, 3, 4, 4] and `bev` [F, 3, 3], int32."""

    confusions: NDArray[np.int32]
    bev: NDArray[np.int32]

    def packed(self) -> bytes:
        """For a row, until the join."""
        return zlib.compress(self.raw(), 1)

    def raw(self) -> bytes:
        return self.confusions.astype("<i4").tobytes() + self.bev.astype("<i4").tobytes()


@dataclass(frozen=True, eq=False)
class ExaminedRange:
    """What is wrong with a range, and, where nothing is and it was to be counted, its counts."""

    validation: Validation
    counts: Counts | None = field(default=None)


def examined(
    submission: SubmissionZip,
    tokens: Sequence[str],
    truth_of: TruthOf | None = None,
    *,
    threads: int = THREADS,
    progress: Progress = silent,
) -> ExaminedRange:
    """These frames of a submission, counted against their truth or, without it, only checked.

    Raises what `truth_of` raises.
    """
    if truth_of is None:
        return ExaminedRange(verdict(check_range(submission, tokens, threads=threads, progress=progress)))
    counted = count_range(submission, tokens, truth_of, threads=threads, progress=progress)
    validation = verdict(counted.problems)
    return ExaminedRange(validation, Counts(counted.confusions, counted.bev) if validation.ok else None)


def joined(ranges: Iterable[ExaminedRange]) -> ExaminedRange:
    """Ranges, in their order, as one; it has counts where each of them has."""
    given = list(ranges)
    counts = [one.counts for one in given if one.counts is not None]
    validation = merged(one.validation for one in given)
    return ExaminedRange(validation, _concatenated(counts) if counts and len(counts) == len(given) else None)


def _concatenated(counts: Sequence[Counts]) -> Counts:
    return Counts(*(np.concatenate([getattr(one, name) for one in counts]) for name in ("confusions", "bev")))
