"""Re-scores and activations as the API shows them."""

from collections.abc import Mapping
from dataclasses import asdict

from sqlalchemy.orm import Session

from api.schemas.base import instant, instant_or_none
from api.schemas.jobs import FailureItem
from api.schemas.rescores import ActivationItem, MovedItem, RescoreDiffAnswer, RescoreItem, RescoreState, SideItem
from services.domain.benchmarks.rescores.diff import RescoreDiff, RescoreMove
from services.domain.benchmarks.rescores.progress import RescoreProgress, missing_ids, rescore_progress
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Activation, Job, Rescore

MOST_NAMED = 20


def rescore_item(session: Session, rescore: Rescore) -> RescoreItem:
    """The re-score with its progress."""
    progress = rescore_progress(session, rescore)
    run = session.get(Job, rescore.job_id) if rescore.job_id else None
    has_failed = run is not None and bool(run.failure_code)
    return RescoreItem(
        id=rescore.id,
        phase_id=rescore.phase_id,
        truth_id=rescore.truth_id,
        metric=rescore.metric,
        reason=rescore.reason,
        state=_state(rescore, progress, run),
        **asdict(progress),
        missing_submission_ids=missing_ids(session, rescore, MOST_NAMED),
        job_id=rescore.job_id,
        failure=FailureItem(code=run.failure_code, sentence=run.failure) if run and has_failed else None,
        created_at=instant(rescore.created_ns),
        activated_at=instant_or_none(rescore.activated_ns),
        abandoned_at=instant_or_none(rescore.abandoned_ns),
    )


def diff_answer(rescore: RescoreItem, diff: RescoreDiff) -> RescoreDiffAnswer:
    return RescoreDiffAnswer(
        rescore=rescore,
        old=SideItem(**asdict(diff.old)) if diff.old else None,
        new=SideItem(**asdict(diff.new)),
        is_order_changed=diff.is_order_changed,
        is_new_leader=diff.is_new_leader,
        largest_rank_move=diff.largest_rank_move,
        largest_value_move=diff.largest_value_move,
        without_new_score=diff.without_new_score,
        rows=[_moved(row) for row in diff.rows],
    )


def activation_item(row: Activation) -> ActivationItem:
    return ActivationItem(
        id=row.id,
        phase_id=row.phase_id,
        truth_id=row.truth_id,
        metric=row.metric,
        rescore_id=row.rescore_id,
        activated_at=instant(row.activated_ns),
    )


def _state(rescore: Rescore, progress: RescoreProgress, run: Job | None) -> RescoreState:
    if rescore.activated_ns is not None:
        return "activated"
    if rescore.abandoned_ns is not None:
        return "abandoned"
    if progress.is_complete:
        return "complete"
    return "running" if run is not None and run.state not in TERMINAL else "incomplete"


def _moved(row: RescoreMove) -> MovedItem:
    sides: Mapping[str, Mapping[str, float | None] | None] = {"old": row.old, "new": row.new}
    return MovedItem(
        submission_id=row.submission_id,
        team=row.team,
        method=row.method,
        modality=row.modality,
        kind=row.kind,
        **{name: None if side is None else dict(side) for name, side in sides.items()},
        old_rank=row.old_rank,
        new_rank=row.new_rank,
        rank_move=row.rank_move,
        value_move=row.value_move,
    )
