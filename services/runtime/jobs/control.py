"""Control of jobs (cancel, terminate, retry) and of queues (pause, drain, open).

**Conventions.** Control applies to runs, because a partial run is useless. Each function is part of the caller's
transaction.
"""

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.jobs.changes import lock_run, rows_changed
from services.runtime.jobs.claims import wake_ups_wanted
from services.runtime.jobs.completion import cancel_queued, settle
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, JobAttempt, JobNeed, Queue
from services.runtime.orm.base import now_ns

ALIVE = "queued or running"


def cancel(session: Session, root_id: str, reason: str) -> Job:
    """Cancel a run: queued jobs do not start, running jobs stop at their next progress report.

    Raises `JobStateError` if it has already ended.
    """
    run = _alive(session, root_id, "cancelled")
    run.cancel_reason = reason or "requested by its owner"
    if run.queue and run.state == "queued":
        run.state, run.finished_ns = "cancelled", now_ns()
    run.revision += 1
    cancel_queued(session, run)
    settle(session, run)
    return run


def terminate(session: Session, root_id: str, reason: str) -> Job:
    """Stop a run at once: its attempts lose their leases, and their processes end at the next heartbeat.

    Raises `JobStateError` if it has already ended.
    """
    run = _alive(session, root_id, "terminated")
    run.cancel_reason = reason or "terminated"
    session.flush()
    doomed = select(Job.id, Job.attempt).where(Job.root_id == root_id, Job.state == "running", Job.queue != "")
    for job_id, number in session.execute(doomed).all():
        attempt = update(JobAttempt).where(JobAttempt.job_id == job_id, JobAttempt.number == number)
        session.execute(attempt.values(outcome="cancelled", failure=run.cancel_reason, finished_ns=now_ns()))
    alive = update(Job).where(Job.root_id == root_id, Job.state.in_(("queued", "running")))
    session.execute(
        alive.values(state="cancelled", finished_ns=now_ns(), revision=Job.revision + 1),
        execution_options={"synchronize_session": False},
    )
    session.refresh(run)
    return run


def retry(session: Session, root_id: str, max_attempts: int) -> Job:
    """Queue the failed and cancelled jobs of a run again; succeeded jobs stay done.

    Raises `JobStateError` for a run that has not failed and was not cancelled.
    """
    run = lock_run(session, root_id)
    if run.state not in ("failed", "cancelled"):
        raise JobStateError(root_id, run.state, "retried", "failed or cancelled")
    run.failure_code = run.failure = run.cancel_reason = ""
    run.state, run.finished_ns, run.revision = "queued", None, run.revision + 1
    session.flush()
    again = select(Job).where(Job.root_id == root_id, Job.queue != "", Job.state != "succeeded")
    for job in session.scalars(again.execution_options(populate_existing=True)).all():
        job.state, job.attempts_left, job.finished_ns, job.revision = "queued", max_attempts, None, job.revision + 1
        job.failure_code = job.failure = job.cancel_reason = ""
        job.needs_left = _needs_left(session, job.id)
        if job.needs_left == 0:
            job.ready_ns = now_ns()
            wake_up_after_commit(session, job.queue)
    settle(session, run)  # if its last job succeeded despite the cancellation, nothing is left to do
    return run


def give_up(session: Session, job_id: str) -> None:
    """Remove the remaining attempts of a running job, whose failure becomes final (a dead letter)."""
    rows_changed(session, update(Job).where(Job.id == job_id, Job.state == "running").values(attempts_left=0))


def set_mode(session: Session, queue: str, mode: str) -> Queue:
    """Switch a queue to open, paused or draining; opening sends wake-ups for waiting jobs."""
    row = session.get(Queue, queue) or Queue(name=queue)
    row.mode = mode
    session.add(row)
    session.flush()
    if mode != "paused":
        wake_up_after_commit(session, queue, wake_ups_wanted(session, queue))
    return row


def _alive(session: Session, root_id: str, act: str) -> Job:
    run = lock_run(session, root_id)
    if run.state in TERMINAL:
        raise JobStateError(root_id, run.state, act, ALIVE)
    return run


def _needs_left(session: Session, job_id: str) -> int:
    """Return the number of its needed jobs that have not succeeded."""
    needed = select(func.count()).select_from(JobNeed).join(Job, Job.id == JobNeed.needed_id)
    return session.scalar(needed.where(JobNeed.job_id == job_id, Job.state != "succeeded")) or 0
