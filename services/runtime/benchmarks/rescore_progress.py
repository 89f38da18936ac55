"""How far a re-score is: which submissions stand, have their new score, can still get it, or cannot.

**Conventions.** Standing are scored entries and baselines that were not withdrawn; hidden ones stand, since they may be
shown again. Gone are those of them that can have no new score because their zip was purged: they keep their old one and
leave the board.
"""

from dataclasses import dataclass

from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select
from sqlalchemy.orm import Session, aliased

from services.runtime.benchmarks.pairs import Pair
from services.runtime.benchmarks.visibility import ON_BOARDS
from services.runtime.orm import Job, Rescore, Score, Submission


@dataclass(frozen=True)
class RescoreProgress:
    """Of `total` standing submissions `scored` have their new score, `missing` can still get it, `gone` cannot.

    `hidden` can get it too, but are hidden, so that nobody misses them on the board. What is being scored for the first
    time is not counted: once settled it is scored by every pair that is pending or in force then.
    """

    total: int
    scored: int
    missing: int
    hidden: int
    gone: int

    @property
    def is_complete(self) -> bool:
        return not self.missing


def rescore_progress(session: Session, rescore: Rescore) -> RescoreProgress:
    """How far it is, judged by the scores there are and not by its run."""
    pair = Pair(rescore.truth_id, rescore.metric)
    of_phase, lacking = _standing(rescore.phase_id), _lacking(rescore.phase_id, pair)
    total, scored = _count(session, of_phase), _count(session, of_phase.where(_has_score(pair)))
    missing = _count(session, lacking.where(Submission.hidden_ns.is_(None)))
    hidden = _count(session, lacking.where(Submission.hidden_ns.is_not(None)))
    return RescoreProgress(total, scored, missing, hidden, total - scored - missing - hidden)


def lacking_ids(session: Session, phase_id: str, pair: Pair) -> list[str]:
    """Standing submissions that have no score by the pair and can get one, oldest first."""
    return list(session.scalars(_lacking(phase_id, pair)))


def missing_ids(session: Session, rescore: Rescore, most: int) -> list[str]:
    """The first of the submissions that an activation waits for, oldest first."""
    lacking = _lacking(rescore.phase_id, Pair(rescore.truth_id, rescore.metric))
    return list(session.scalars(lacking.where(Submission.hidden_ns.is_(None)).limit(most)))


def failed_ids(session: Session, run_id: str | None) -> set[str]:
    """The submissions that a job of this run failed for."""
    failed = select(Job.arguments).where(Job.root_id == run_id, Job.id != run_id, Job.state == "failed")
    return {arguments["submission_id"] for arguments in session.scalars(failed) if arguments}


def _standing(phase_id: str) -> Select[str]:
    of_phase = (Submission.phase_id == phase_id, Submission.kind.in_(ON_BOARDS), Submission.state == "scored")
    return select(Submission.id).where(*of_phase, Submission.withdrawn_ns.is_(None))


def _has_score(pair: Pair) -> ColumnElement[bool]:
    by_pair = (Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return exists().where(Score.submission_id == Submission.id, *by_pair)


def _lacking(phase_id: str, pair: Pair) -> Select[str]:
    """Standing submissions without the score that can have it: from their zip, or from counts that are kept."""
    counted = aliased(Score)
    has_counts = exists().where(counted.submission_id == Submission.id, counted.truth_id == pair.truth_id)
    can_be_scored = or_(Submission.blob_sha256.is_not(None), has_counts)
    return _standing(phase_id).where(and_(~_has_score(pair), can_be_scored)).order_by(Submission.id)


def _count(session: Session, ids: Select[str]) -> int:
    return session.scalar(select(func.count()).select_from(ids.order_by(None).subquery())) or 0
