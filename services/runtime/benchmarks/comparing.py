"""Two entries of a phase side by side: how they differ, and whether that is more than chance.

**Conventions.** Differences are a − b by the pair in force, from draws that are paired. `block` resamples blocks of
frames inside the sequences that there are; `sequence` whole sequences, which answers for a new place, and beside it an
exact test over the few there are. While a phase hides its truth only the difference of rounded totals is told.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from services.runtime.benchmarks.board_draws import BLOCK, SEQUENCE, read_draws, varies
from services.runtime.benchmarks.pairs import active
from services.runtime.benchmarks.result_errors import NotComparableError, NotScoredError
from services.runtime.benchmarks.results import Seen, seen_score
from services.runtime.benchmarks.visibility import Viewer, rounded
from services.runtime.orm import Blob, Phase, Submission
from services.runtime.platform import Platform
from services.runtime.store import Store
from stone.metric import RATIOS
from stone.ranking import Difference, SignFlip, paired, sign_flip


@dataclass(frozen=True)
class RatioDifference:
    """Of one ratio; null where undefined, withheld, or where resampling tells nothing."""

    a: float | None
    b: float | None
    difference: float | None
    block: Difference | None = None
    sequence: Difference | None = None
    sign_flip: SignFlip | None = None


@dataclass(frozen=True)
class Comparison:
    """`sequences` is how many the ground truth has."""

    a: Seen
    b: Seen
    ratios: Mapping[str, RatioDifference]
    is_withheld: bool


@dataclass(frozen=True)
class _Drawn:
    """Draws (D, 5) of both entries."""

    a: Any
    b: Any

    def of(self, column: int) -> Difference | None:
        return paired(self.a[:, column], self.b[:, column]) if self._is_telling else None

    @property
    def _is_telling(self) -> bool:
        return self.a.shape == self.b.shape and (varies(self.a) or varies(self.b))


def compare(platform: Platform, phase_id: str, pair: tuple[Submission, Submission], viewer: Viewer) -> Comparison:
    """Two submissions that the viewer may know of. Raises `NotComparableError`, `StoreAwayError`."""
    with platform.database.reading() as session:
        phase = session.get_one(Phase, phase_id)
        a, b = (_scored(session, viewer, phase, submission) for submission in pair)
        keys = [session.get_one(Blob, seen.score.draws_sha256).object_key for seen in (a, b)]
    is_withheld = not (a.policy.shows("comparison") and b.policy.shows("comparison"))
    totals = {name: _totals(a, b, name) for name in RATIOS}
    if is_withheld:
        return Comparison(a, b, totals, True)
    block, sequence = (_drawn(platform.store, keys, kind) for kind in (BLOCK, SEQUENCE))
    return Comparison(
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


def _scored(session: Session, viewer: Viewer, phase: Phase, submission: Submission) -> Seen:
    if submission.phase_id != phase.id or active(session, phase.id) is None:
        raise NotComparableError(submission.id, phase.name)
    try:
        return seen_score(session, viewer, submission)
    except NotScoredError as error:
        raise NotComparableError(submission.id, phase.name) from error


def _totals(a: Seen, b: Seen, name: str) -> RatioDifference:
    of_a, of_b = (seen.policy.ratio(getattr(seen.score, name)) for seen in (a, b))
    is_exact = a.policy.shows("exact") and b.policy.shows("exact")
    return RatioDifference(of_a, of_b, _difference(of_a, of_b, is_exact))


def _drawn(store: Store, keys: list[str], kind: str) -> _Drawn:
    return _Drawn(*(np.asarray(read_draws(store, key, kind)) for key in keys))


def _flipped(a: Seen, b: Seen, name: str) -> SignFlip | None:
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
