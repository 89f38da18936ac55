"""Jobs as the API shows them: rows of `services.runtime.orm.jobs` become bodies of `api.schemas.jobs`."""

from collections.abc import Sequence
from dataclasses import asdict

from sqlalchemy import bindparam, case, func, select
from sqlalchemy.orm import Session

from api.schemas.base import instant, instant_or_none
from api.schemas.jobs import AttemptItem, FailureItem, JobDetail, JobItem, ProgressItem, StageItem
from services.runtime.jobs.queries import Progress, progress_of, rated
from services.runtime.orm import Job, JobAttempt

# Built once: to build a statement for fifty ids costs more than to run it.
COUNTED = (
    select(Job.root_id, func.sum(case((Job.state == "succeeded", 1), else_=0)), func.count())
    .where(Job.root_id.in_(bindparam("runs", expanding=True)), Job.queue != "")
    .group_by(Job.root_id)
)


def job_items(session: Session, jobs: Sequence[Job]) -> list[JobItem]:
    """Jobs as a list shows them; the progress of all runs among them is one statement."""
    runs = [job.id for job in jobs if not job.queue]
    counts = {root: (done, total) for root, done, total in session.execute(COUNTED, {"runs": runs})}
    return [job_item(job, _glance(session, job, counts.get(job.id, (0, 0)))) for job in jobs]


def job_detail(session: Session, job: Job) -> JobDetail:
    """A job with its attempts, a run with its stages."""
    progress = progress_of(session, job)
    attempts = select(JobAttempt).where(JobAttempt.job_id == job.id).order_by(JobAttempt.number)
    return JobDetail(
        **dict(job_item(job, progress)),
        stages=[StageItem(**asdict(stage)) for stage in progress.stages],
        attempts=[_attempt(row) for row in session.scalars(attempts)],
        attempts_left=job.attempts_left if job.queue else 0,
        result=job.result,
    )


def _glance(session: Session, job: Job, counts: tuple[int, int]) -> Progress:
    if job.queue:
        return progress_of(session, job)
    return rated(job, "", *counts)


def job_item(job: Job, progress: Progress) -> JobItem:
    return JobItem(
        id=job.id,
        root_id=job.root_id,
        owner_id=job.owner_id,
        sequence_id=job.sequence_id,
        kind=job.kind,
        queue=job.queue,
        state=job.state,
        priority=job.priority,
        attempt=job.attempt,
        progress=_progress(progress),
        failure=_failure(job),
        cancel_reason=job.cancel_reason,
        revision=job.revision,
        created_at=instant(job.created_ns),
        started_at=instant_or_none(job.started_ns),
        finished_at=instant_or_none(job.finished_ns),
    )


def _progress(progress: Progress) -> ProgressItem:
    return ProgressItem(
        stage=progress.stage,
        done=progress.done,
        total=progress.total,
        rate_per_s=progress.rate_per_s,
        eta_s=progress.eta_s,
    )


def _attempt(row: JobAttempt) -> AttemptItem:
    return AttemptItem(
        number=row.number,
        worker=row.worker,
        outcome=row.outcome,
        failure=_failure(row),
        peak_bytes=row.peak_bytes,
        started_at=instant(row.started_ns),
        finished_at=instant_or_none(row.finished_ns),
    )


def _failure(row: Job | JobAttempt) -> FailureItem | None:
    if not row.failure_code and not row.failure:
        return None
    return FailureItem(code=row.failure_code, sentence=row.failure)
