"""The join of a submission with a ground truth by a metric: all its counts → its score, or what is wrong with it.

**Conventions.** Counts come from wherever they are: kept with an earlier score against the same ground truth, from
parts, and where neither has them they are counted here. Slow things come first; rows, what follows for the submission
and the job's success are one transaction. What a job answers tells nothing but where the submission stands.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
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
from services.runtime.orm import Blob, Score, ScorePart


@dataclass(frozen=True)
class Kept:
    """What is there of a submission's counts: the object of an earlier score's, else parts in their order."""

    confusions_key: str = ""
    parts: tuple[ScorePart, ...] = field(default=())

    def gaps(self, frames: int) -> Iterator[Span]:
        """The ranges of [0, frames) that no part has."""
        at = 0
        for part in self.parts:
            if part.start > at:
                yield at, part.start
            at = part.stop
        if at < frames:
            yield at, frames


def join(desk: Desk) -> Outcome:
    """Score the submission by the pair, unless that is done or nothing is to be scored any more."""
    pair = desk.pair
    case = desk.case(pair.truth_id)
    with desk.platform.database.reading() as session:
        if case.is_over or _is_scored(session, case, pair):
            return Outcome({"state": case.state})
        kept = _kept(session, case)
    return concluded(desk, case, pair, _whole(desk, case, kept))


def concluded(desk: Desk, case: Case, pair: Pair, whole: Examined) -> Outcome:
    """What becomes of a submission when all its frames were looked at."""
    if not whole.validation.ok:
        return refuse(desk, case, whole.validation)
    if whole.counts is None:
        return Outcome({"state": "valid"}, commit=partial(write_verdict, case, "valid", None))
    new = made_score(desk, case, pair, whole.counts)
    return Outcome({"state": "scored"}, commit=partial(write, desk, case, new))


def _is_scored(session: Session, case: Case, pair: Pair) -> bool:
    by_pair = (Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return session.scalar(select(Score.id).where(Score.submission_id == case.submission_id, *by_pair)) is not None


def _kept(session: Session, case: Case) -> Kept:
    of_score = (Score.submission_id == case.submission_id, Score.truth_id == case.truth.id)
    counted = select(Blob.object_key).join(Score, Score.confusions_sha256 == Blob.sha256).where(*of_score)
    key = session.scalar(counted.order_by(Score.id).limit(1))
    if key is not None:
        return Kept(key)
    of_parts = (ScorePart.submission_id == case.submission_id, ScorePart.truth_id == case.truth.id)
    return Kept(parts=tuple(session.scalars(select(ScorePart).where(*of_parts).order_by(ScorePart.start))))


def _whole(desk: Desk, case: Case, kept: Kept) -> Examined:
    """All frames, in their order."""
    if kept.confusions_key:
        return Examined(merged(()), _kept_counts(desk.platform.store.local(kept.confusions_key)))
    counted = {gap[0]: desk.examined(case, gap) for gap in kept.gaps(case.truth.frames)}
    counted |= {part.start: _of_part(part) for part in kept.parts}
    ranges = [examined for _, examined in sorted(counted.items())]
    counts = [one.counts for one in ranges if one.counts is not None]
    return Examined(merged(one.validation for one in ranges), joined(counts) if len(counts) == len(ranges) else None)


def _of_part(part: ScorePart) -> Examined:
    counts = unpacked(part.counts, part.stop - part.start) if part.counts else None
    return Examined(validation_of(part.problems), counts)


def _kept_counts(path: Path) -> Counts:
    with np.load(path, allow_pickle=False) as arrays:
        return Counts(arrays["confusions"], arrays["bev"])
