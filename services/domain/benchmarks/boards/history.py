"""The history of a leaderboard: the times at which it changed.

**Conventions.** A board changes when an entry is scored, withdrawn or hidden, when a reported row is added, and when
another evaluation version becomes active. Changes less than a microsecond apart are merged. If there are more than
`MOST_CHANGES`, the changes of each day are merged into the last; if there are still more, only the latest are kept.
`best` is rounded for every viewer, as in the board's order.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.boards.entries import Track
from services.domain.benchmarks.phases.reported_results import is_reported_on
from services.domain.benchmarks.visibility import ON_BOARDS, rounded
from services.runtime.orm import Activation, Phase, Reported, Score, SubmissionRow
from stone.scoring.metric import RATIOS

MOST_CHANGES = 120
DAY_NS = 86_400 * 10**9


@dataclass(frozen=True)
class BoardChange:
    """A change of the board at `at_ns`; `best` is then the highest mIoU of the entries, or null if none has a mIoU."""

    at_ns: int
    entered: int = 0
    left: int = 0
    is_new_pair: bool = False
    best: float | None = None


@dataclass(frozen=True)
class _BoardPeriod:
    """A score's time on the board, [from_ns, until_ns); `miou` is null for an unranked row."""

    pair: tuple[str, str]
    miou: float | None
    from_ns: int
    until_ns: int | None

    def stands(self, at_ns: int) -> bool:
        return self.from_ns <= at_ns and (self.until_ns is None or at_ns < self.until_ns)


def history(session: Session, phase: Phase, track: Track = "all") -> tuple[BoardChange, ...]:
    """Return the changes of a track's board, oldest first; none before the phase's first ground truth."""
    pairs = _versions(session, phase)
    if not pairs:
        return ()
    moments = [*_comings(session, phase, track), *(BoardChange(at_ns, is_new_pair=True) for at_ns, _ in pairs)]
    since = [change for change in moments if change.at_ns >= pairs[0][0]]
    stays = _stays(session, phase, track)
    return tuple(replace(moment, best=_best(stays, pairs, moment.at_ns)) for moment in _round_and_merge(since))


def tracks_with_rows(session: Session, phase: Phase) -> frozenset[str]:
    """Return the modalities that have, or had, a row on the board; ceilings are on every track."""
    scored = select(SubmissionRow.modality).where(*_of_board(phase)).distinct()
    reported = select(Reported.modality).where(Reported.phase_id == phase.id, Reported.kind == "published").distinct()
    return frozenset((*session.scalars(scored), *session.scalars(reported)))


def _of_board(phase: Phase) -> tuple[Any, ...]:
    return (SubmissionRow.phase_id == phase.id, SubmissionRow.state == "scored", SubmissionRow.kind.in_(ON_BOARDS))


def _versions(session: Session, phase: Phase) -> list[tuple[int, tuple[str, str]]]:
    activations = (
        select(Activation).where(Activation.phase_id == phase.id).order_by(Activation.activated_ns, Activation.id)
    )
    return [(row.activated_ns, (row.truth_id, row.metric)) for row in session.scalars(activations)]


def _comings(session: Session, phase: Phase, track: Track) -> Iterable[BoardChange]:
    submissions = select(SubmissionRow.settled_ns, SubmissionRow.withdrawn_ns, SubmissionRow.hidden_ns).where(
        *_of_board(phase)
    )
    reported = select(Reported.created_ns).where(Reported.phase_id == phase.id)
    if track != "all":
        submissions = submissions.where(SubmissionRow.modality == track)
        reported = reported.where(is_reported_on(track))
    for settled_ns, withdrawn_ns, hidden_ns in session.execute(submissions):
        ends = [at_ns for at_ns in (withdrawn_ns, hidden_ns) if at_ns is not None]
        if settled_ns is None or (ends and min(ends) <= settled_ns):
            continue
        yield BoardChange(settled_ns, entered=1)
        if ends:
            yield BoardChange(min(ends), left=1)
    yield from (BoardChange(at_ns, entered=1) for at_ns in session.scalars(reported))


def _stays(session: Session, phase: Phase, track: Track) -> list[_BoardPeriod]:
    times = (SubmissionRow.kind, SubmissionRow.settled_ns, SubmissionRow.withdrawn_ns, SubmissionRow.hidden_ns)
    ratios = [getattr(Score, name) for name in RATIOS]
    scores = (
        select(Score.truth_id, Score.metric, *times, *ratios)
        .join(SubmissionRow, SubmissionRow.id == Score.submission_id)
        .where(*_of_board(phase), SubmissionRow.settled_ns.is_not(None))
    )
    if track != "all":
        scores = scores.where(SubmissionRow.modality == track)
    stays = []
    for truth_id, metric, kind, settled_ns, withdrawn_ns, hidden_ns, *values in session.execute(scores):
        is_ranked = kind != "baseline" and all(value is not None for value in values)
        ends = [at_ns for at_ns in (withdrawn_ns, hidden_ns) if at_ns is not None]
        miou = rounded(values[RATIOS.index("miou")]) if is_ranked else None
        stays.append(_BoardPeriod((truth_id, metric), miou, settled_ns, min(ends, default=None)))
    return stays


def _best(stays: Sequence[_BoardPeriod], pairs: Sequence[tuple[int, tuple[str, str]]], at_ns: int) -> float | None:
    pair = [pair for since_ns, pair in pairs if since_ns <= at_ns][-1]
    return max((s.miou for s in stays if s.miou is not None and s.pair == pair and s.stands(at_ns)), default=None)


def _round_and_merge(moments: Iterable[BoardChange]) -> list[BoardChange]:
    """Return the changes in order, rounded up to the microsecond as in API requests, without duplicates."""
    exact = [replace(moment, at_ns=-(-moment.at_ns // 1000) * 1000) for moment in moments]
    merged = _merge_changes(exact, 1)
    return merged if len(merged) <= MOST_CHANGES else _merge_changes(merged, DAY_NS)[-MOST_CHANGES:]


def _merge_changes(moments: Iterable[BoardChange], within_ns: int) -> list[BoardChange]:
    """Merge the changes within each stretch of this length into the last of them."""
    ordered = sorted(moments, key=lambda change: change.at_ns)
    stretches = (list(some) for _, some in groupby(ordered, key=lambda change: change.at_ns // within_ns))
    return [
        BoardChange(
            some[-1].at_ns,
            sum(change.entered for change in some),
            sum(change.left for change in some),
            any(change.is_new_pair for change in some),
        )
        for some in stretches
    ]
