"""Requeues jobs that a stopped platform left running, without waiting for their leases.

**Conventions.** Only for whoever knows that the workers in question have ended: the embedded supervisor, which holds
the data folder and has seen its worker end, and a worker that has killed its own processes. An attempt cut off by an
orderly stop is given back to the job; one cut off by a crash counts.
"""

from collections.abc import Sequence

from sqlalchemy import select, update

from services.runtime.jobs.changes import lock_run, rows_changed
from services.runtime.jobs.claims import Claim
from services.runtime.jobs.completion import Failure, lose
from services.runtime.orm import Job, JobAttempt
from services.runtime.platform import Platform

STOPPED = Failure("platform_stopped", "the platform was stopped while this attempt ran")
WORKER_STOPPED = Failure("worker_stopped", "the worker was stopped while this attempt ran")
CRASHED = Failure("worker_lost", "the platform ended while this attempt ran")


def give_back_running(platform: Platform, failure: Failure, *, is_counted: bool) -> int:
    """Queue every running job again; `is_counted`: against its attempts. How many there were.

    A job without attempts left fails with `failure`; one that was asked to stop is cancelled.
    """
    with platform.database.reading() as session:
        running = session.scalars(select(Job).where(Job.state == "running", Job.queue != "")).all()
    return _interrupt_all(platform, running, failure, is_counted=is_counted)


def give_back_of(platform: Platform, workers: Sequence[str], failure: Failure) -> int:
    """Queue again what these processes ran, which have ended; it costs no attempt. How many there were.

    `workers` are their names (`worker_name`).
    """
    held = (JobAttempt.job_id == Job.id) & (JobAttempt.number == Job.attempt)
    ours = select(Job).join(JobAttempt, held).where(Job.state == "running", JobAttempt.worker.in_(workers))
    with platform.database.reading() as session:
        running = session.scalars(ours.where(Job.queue != "")).all()
    return _interrupt_all(platform, running, failure, is_counted=False)


def _interrupt_all(platform: Platform, running: Sequence[Job], failure: Failure, *, is_counted: bool) -> int:
    for job in running:
        claim = Claim(job.id, job.root_id, job.sequence_id, job.kind, job.attempt, {})
        _interrupt(platform, claim, failure, is_counted=is_counted)
    return len(running)


def _interrupt(platform: Platform, claim: Claim, failure: Failure, *, is_counted: bool) -> None:
    with platform.database.transaction() as session:
        lock_run(session, claim.root_id)
        if not is_counted:
            held = update(Job).where(Job.id == claim.job_id, Job.state == "running", Job.attempt == claim.attempt)
            rows_changed(session, held.values(attempts_left=Job.attempts_left + 1))
        lose(session, claim, failure)
