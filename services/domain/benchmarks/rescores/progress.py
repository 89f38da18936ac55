"""Progress of a re-score: submissions scored, missing, or impossible to score.

**Conventions.** The board contains scored entries and baselines that were not withdrawn. Hidden submissions are
included, since they may be shown again. A submission is `gone` if it can have no new score because its zip was deleted:
it keeps its old score and leaves the board.
"""

from dataclasses import dataclass

from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select
from sqlalchemy.orm import Session, aliased

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.visibility import ON_BOARDS
from services.runtime.orm import Job, Rescore, Score, SubmissionRow


@dataclass(frozen=True)
class RescoreProgress:
    """Counts of the `total` submissions on the board: `scored`, `missing` (can still be scored), `gone` (cannot).

    `hidden` submissions can get it too, but the board does not need them. Submissions that are being scored for the
    first time are not counted: they get a score by every pending or active evaluation version.
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
    """Return the progress of a re-score, judged by existing scores and not by its run."""
    pair = EvaluationVersion(rescore.truth_id, rescore.metric)
    of_phase, lacking = _submissions_on_board(rescore.phase_id), _lacking(rescore.phase_id, pair)
    total, scored = _count(session, of_phase), _count(session, of_phase.where(_has_score(pair)))
    missing = _count(session, lacking.where(SubmissionRow.hidden_ns.is_(None)))
    hidden = _count(session, lacking.where(SubmissionRow.hidden_ns.is_not(None)))
    return RescoreProgress(total, scored, missing, hidden, total - scored - missing - hidden)


def lacking_ids(session: Session, phase_id: str, pair: EvaluationVersion) -> list[str]:
    """Return submissions on the board that lack a score by the evaluation version and can get it, oldest first."""
    return list(session.scalars(_lacking(phase_id, pair)))


def missing_ids(session: Session, rescore: Rescore, most: int) -> list[str]:
    """Return the first `most` submissions whose scores an activation requires, oldest first."""
    lacking = _lacking(rescore.phase_id, EvaluationVersion(rescore.truth_id, rescore.metric))
    return list(session.scalars(lacking.where(SubmissionRow.hidden_ns.is_(None)).limit(most)))


def failed_ids(session: Session, run_id: str | None) -> set[str]:
    """Return the submissions for which a job of this run failed."""
    failed = select(Job.arguments).where(Job.root_id == run_id, Job.id != run_id, Job.state == "failed")
    return {arguments["submission_id"] for arguments in session.scalars(failed) if arguments}


def _submissions_on_board(phase_id: str) -> Select[str]:
    of_phase = (SubmissionRow.phase_id == phase_id, SubmissionRow.kind.in_(ON_BOARDS), SubmissionRow.state == "scored")
    return select(SubmissionRow.id).where(*of_phase, SubmissionRow.withdrawn_ns.is_(None))


def _has_score(pair: EvaluationVersion) -> ColumnElement[bool]:
    by_version = (Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return exists().where(Score.submission_id == SubmissionRow.id, *by_version)


def _lacking(phase_id: str, pair: EvaluationVersion) -> Select[str]:
    """Select submissions on the board that lack the score and can get it from their zip or from stored counts."""
    counted = aliased(Score)
    has_counts = exists().where(counted.submission_id == SubmissionRow.id, counted.truth_id == pair.truth_id)
    can_be_scored = or_(SubmissionRow.blob_sha256.is_not(None), has_counts)
    return _submissions_on_board(phase_id).where(and_(~_has_score(pair), can_be_scored)).order_by(SubmissionRow.id)


def _count(session: Session, ids: Select[str]) -> int:
    return session.scalar(select(func.count()).select_from(ids.order_by(None).subquery())) or 0
