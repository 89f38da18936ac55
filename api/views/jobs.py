"""Jobs as the API shows them: rows of `services.runtime.orm.jobs` become bodies of `api.schemas.jobs`."""

from collections.abc import Sequence

from sqlalchemy import bindparam, case, func, select
from sqlalchemy.orm import Session

from api.schemas.base import instant, instant_or_none
from api.schemas.jobs import AttemptItem, FailureItem, JobDetail, JobItem, ProgressItem, StageItem
from services.domain.runs.estimates import time_left
from services.runtime.jobs.queries import Progress, StageProgress, progress_of
from services.runtime.jobs.titles import title_of
from services.runtime.orm import Job, JobAttempt

# Built once: to build a statement for fifty ids costs more than to run it.
COUNTED = (
    select(Job.root_id, func.sum(case((Job.state == "succeeded", 1), else_=0)), func.count())
    .where(Job.root_id.in_(bindparam("runs", expanding=True)), Job.queue != "")
    .group_by(Job.root_id)
)


def job_items(session: Session, jobs: Sequence[Job]) -> list[JobItem]:
    """Jobs as a list shows them; the progress of all runs among them is one statement, and so are their estimates."""
    runs = [job.id for job in jobs if not job.queue]
    counts = {root: (done, total) for root, done, total in session.execute(COUNTED, {"runs": runs})}
    left = time_left(session, jobs)
    return [job_item(job, _glance(session, job, counts.get(job.id, (0, 0))), left.get(job.id)) for job in jobs]


def job_detail(session: Session, job: Job) -> JobDetail:
    """A job with its attempts, a run with its stages."""
    progress = progress_of(session, job)
    attempts = select(JobAttempt).where(JobAttempt.job_id == job.id).order_by(JobAttempt.number)
    return JobDetail(
        **dict(job_item(job, progress, time_left(session, [job]).get(job.id))),
        stages=[_stage(stage) for stage in progress.stages],
        attempts=[_attempt(row) for row in session.scalars(attempts)],
        attempts_left=job.attempts_left if job.queue else 0,
        result=job.result,
    )


def _glance(session: Session, job: Job, counts: tuple[int, int]) -> Progress:
    if job.queue:
        return progress_of(session, job)
    return Progress("", *counts)


def job_item(job: Job, progress: Progress, left_s: int | None) -> JobItem:
    """`left_s` is the estimate of `services/domain/runs/estimates.py`."""
    return JobItem(
        id=job.id,
        root_id=job.root_id,
        owner_id=job.owner_id,
        sequence_id=job.sequence_id,
        kind=job.kind,
        title=title_of(job.kind),
        queue=job.queue,
        state=job.state,
        priority=job.priority,
        attempt=job.attempt,
        progress=_progress(progress, left_s),
        failure=_failure(job),
        cancel_reason=job.cancel_reason,
        revision=job.revision,
        created_at=instant(job.created_ns),
        started_at=instant_or_none(job.started_ns),
        finished_at=instant_or_none(job.finished_ns),
    )


def _stage(stage: StageProgress) -> StageItem:
    return StageItem(
        kind=stage.kind,
        title=title_of(stage.kind),
        total=stage.total,
        done=stage.done,
        running=stage.running,
        failed=stage.failed,
        began_at=instant_or_none(stage.began_ns),
        ended_at=instant_or_none(stage.ended_ns),
        busy_s=stage.busy_ns / 1e9,
    )


def _progress(progress: Progress, left_s: int | None) -> ProgressItem:
    return ProgressItem(
        stage=progress.stage,
        done=progress.done,
        total=progress.total,
        rate_per_s=progress.rate_per_s,
        eta_s=left_s,
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
