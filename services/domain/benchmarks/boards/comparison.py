"""Comparison of two entries of a phase: differences and their significance.

**Conventions.** Differences are a − b by the evaluation version in force, from replicates that are paired. `block`
resamples blocks of frames inside the sequences that there are; `sequence` whole sequences, which answers for a new
place, and beside it an exact test over the few there are. While a phase hides its truth only the difference of rounded
totals is told.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from services.domain.benchmarks.boards.bootstrap import BLOCK, SEQUENCE, read_replicates, varies
from services.domain.benchmarks.phases.evaluation_versions import active
from services.domain.benchmarks.submissions.result_errors import NotComparableError, NotScoredError
from services.domain.benchmarks.submissions.results import ScoreView, seen_score
from services.domain.benchmarks.visibility import Viewer, rounded
from services.runtime.orm import Blob, Phase, SubmissionRow
from services.runtime.platform import Platform
from services.runtime.store.protocol import Store
from stone.scoring.metric import RATIOS
from stone.scoring.ranking import Difference, SignFlip, paired, sign_flip


@dataclass(frozen=True)
class RatioDifference:
    """The difference of one ratio; null where undefined, withheld, or where resampling tells nothing."""

    a: float | None
    b: float | None
    difference: float | None
    block: Difference | None = None
    sequence: Difference | None = None
    sign_flip: SignFlip | None = None


@dataclass(frozen=True)
class EntryComparison:
    """`sequences` is how many the ground truth has."""

    a: ScoreView
    b: ScoreView
    ratios: Mapping[str, RatioDifference]
    is_withheld: bool


@dataclass(frozen=True)
class _PairedReplicates:
    """Replicates (D, 5) of both entries."""

    a: Any
    b: Any

    def of(self, column: int) -> Difference | None:
        return paired(self.a[:, column], self.b[:, column]) if self._is_conclusive else None

    @property
    def _is_conclusive(self) -> bool:
        return self.a.shape == self.b.shape and (varies(self.a) or varies(self.b))


def compare(
    platform: Platform, phase_id: str, pair: tuple[SubmissionRow, SubmissionRow], viewer: Viewer
) -> EntryComparison:
    """Two submissions that the viewer may know of. Raises `NotComparableError`, `StoreAwayError`."""
    with platform.database.reading() as session:
        phase = session.get_one(Phase, phase_id)
        a, b = (_scored(session, viewer, phase, submission) for submission in pair)
        keys = [session.get_one(Blob, seen.score.replicates_sha256).object_key for seen in (a, b)]
    is_withheld = not (a.policy.shows("comparison") and b.policy.shows("comparison"))
    totals = {name: _totals(a, b, name) for name in RATIOS}
    if is_withheld:
        return EntryComparison(a, b, totals, True)
    block, sequence = (_paired_replicates(platform.store, keys, kind) for kind in (BLOCK, SEQUENCE))
    return EntryComparison(
        a,
        b,
        {
            name: RatioDifference(
                totals[name].a,
                totals[name].b,
                totals[name].difference,
                block.of(column),
                sequence.of(column),
                _flipped(a, b, name),
            )
            for column, name in enumerate(RATIOS)
        },
        False,
    )


def _scored(session: Session, viewer: Viewer, phase: Phase, submission: SubmissionRow) -> ScoreView:
    if submission.phase_id != phase.id or active(session, phase.id) is None:
        raise NotComparableError(submission.id, phase.name)
    try:
        return seen_score(session, viewer, submission)
    except NotScoredError as error:
        raise NotComparableError(submission.id, phase.name) from error


def _totals(a: ScoreView, b: ScoreView, name: str) -> RatioDifference:
    of_a, of_b = (seen.policy.ratio(getattr(seen.score, name)) for seen in (a, b))
    is_exact = a.policy.shows("exact") and b.policy.shows("exact")
    return RatioDifference(of_a, of_b, _difference(of_a, of_b, is_exact))


def _paired_replicates(store: Store, keys: list[str], kind: str) -> _PairedReplicates:
    return _PairedReplicates(*(np.asarray(read_replicates(store, key, kind)) for key in keys))


def _flipped(a: ScoreView, b: ScoreView, name: str) -> SignFlip | None:
    """Over the sequences in which both have the ratio."""
    of_a, of_b = (seen.score.record["by"].get("sequence", {}) for seen in (a, b))
    both = [(of_a[key][name], of_b[key][name]) for key in of_a if key in of_b]
    known = [x - y for x, y in both if x is not None and y is not None]
    return sign_flip(known) if known else None


def _difference(a: float | None, b: float | None, is_exact: bool) -> float | None:
    """a − b of totals as they are shown."""
    if a is None or b is None:
        return None
    return a - b if is_exact else rounded(a - b)
