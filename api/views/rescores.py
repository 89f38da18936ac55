"""Re-scores and activations as the API shows them."""

from dataclasses import asdict

from sqlalchemy.orm import Session

from api.schemas.rescores import RescoreItem, RescoreState
from api.views.jobs import coded_failure
from services.domain.benchmarks.rescores.progress import RescoreProgress, missing_ids, rescore_progress
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, Rescore

MOST_NAMED = 20


def rescore_item(session: Session, rescore: Rescore) -> RescoreItem:
    """Return the re-score with its progress."""
    progress = rescore_progress(session, rescore)
    run = session.get(Job, rescore.job_id) if rescore.job_id else None
    return RescoreItem.of(
        rescore,
        state=_state(rescore, progress, run),
        **asdict(progress),
        missing_submission_ids=missing_ids(session, rescore, MOST_NAMED),
        failure=None if run is None else coded_failure(run),
    )


def _state(rescore: Rescore, progress: RescoreProgress, run: Job | None) -> RescoreState:
    if rescore.activated_ns is not None:
        return "activated"
    if rescore.abandoned_ns is not None:
        return "abandoned"
    if progress.is_complete:
        return "complete"
    return "running" if run is not None and run.state not in TERMINAL else "incomplete"
