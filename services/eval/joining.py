"""The join of a submission with a ground truth by a metric: all its counts → its score, or what is wrong with it.

**Conventions.** Counts come from wherever they are: kept with an earlier score against the same ground truth, from
parts, and where neither has them they are counted here. Slow things come first; rows, what follows for the submission
and the job's success are one transaction. What a job answers tells nothing but where the submission stands.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.eval.cases import Case
from services.eval.desk import Desk
from services.eval.examining import Counts, Examined, Span, joined, unpacked
from services.eval.problems import merged, validation_of
from services.eval.scoring import made_score
from services.eval.settling import refuse, write, write_verdict
from services.runtime.benchmarks.pairs import Pair
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Score, ScorePart


def join(desk: Desk) -> Outcome:
    """Score the submission by the pair, unless that is done or nothing is to be scored any more."""
    pair = desk.pair
    case = desk.case(pair.truth_id)
    with desk.platform.database.reading() as session:
        if case.is_over or _is_scored(session, case, pair):
            return Outcome({"state": case.state})
        parts = _parts(session, case)
    return concluded(desk, case, pair, _whole(desk, case, parts))


def concluded(desk: Desk, case: Case, pair: Pair, whole: Examined) -> Outcome:
    """What becomes of a submission when all its frames were looked at."""
    if not whole.validation.ok:
        return refuse(desk, case, whole.validation)
    if whole.counts is None:
        return Outcome({"state": "valid"}, commit=partial(write_verdict, case, "valid", None))
    new = made_score(desk, case, pair, whole.counts)
    return Outcome({"state": "scored"}, commit=partial(write, desk, case, new))


def gaps(parts: Sequence[ScorePart], frames: int) -> Iterator[Span]:
    """The ranges of [0, frames) that no part has; parts are in their order and do not overlap."""
    at = 0
    for part in parts:
        if part.start > at:
            yield at, part.start
        at = part.stop
    if at < frames:
        yield at, frames


def _is_scored(session: Session, case: Case, pair: Pair) -> bool:
    by_pair = (Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return session.scalar(select(Score.id).where(Score.submission_id == case.submission_id, *by_pair)) is not None


def _parts(session: Session, case: Case) -> Sequence[ScorePart]:
    """Those that were counted, in their order."""
    of_both = (ScorePart.submission_id == case.submission_id, ScorePart.truth_id == case.truth.id)
    return session.scalars(select(ScorePart).where(*of_both).order_by(ScorePart.start)).all()


def _whole(desk: Desk, case: Case, parts: Sequence[ScorePart]) -> Examined:
    """All frames, in their order."""
    if case.confusions_key:
        return Examined(merged(()), _kept_counts(desk.platform.store.local(case.confusions_key)))
    counted = {gap[0]: desk.examined(case, gap) for gap in gaps(parts, case.truth.frames)}
    counted |= {part.start: _of_part(part) for part in parts}
    ranges = [examined for _, examined in sorted(counted.items())]
    counts = [one.counts for one in ranges if one.counts is not None]
    return Examined(merged(one.validation for one in ranges), joined(counts) if len(counts) == len(ranges) else None)


def _of_part(part: ScorePart) -> Examined:
    counts = unpacked(part.counts, part.stop - part.start) if part.counts else None
    return Examined(validation_of(part.problems), counts)


def _kept_counts(path: Path) -> Counts:
    with np.load(path, allow_pickle=False) as arrays:
        return Counts(arrays["confusions"], arrays["bev"])
