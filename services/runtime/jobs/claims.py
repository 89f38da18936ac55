"""Claims the next job of a queue: most urgent first, then the owner with the least running, then the oldest run."""

import os
import socket
from dataclasses import dataclass
from typing import Any

from sqlalchemy import update
from sqlalchemy.orm import Session

from services.runtime.jobs.changes import rows_changed
from services.runtime.jobs.readiness import take_next
from services.runtime.orm import Job, JobAttempt
from services.runtime.orm.base import now_ns
from services.runtime.telemetry.process_usage import used_cpu_s


@dataclass(frozen=True)
class JobOrigin:
    """The origin of a job, and how long it was ready before it was claimed (None: not known)."""

    traceparent: str = ""
    request_id: str = ""
    waited_s: float | None = None


@dataclass(frozen=True)
class Claim:
    """A job that is ours to run: nobody else holds this (job, attempt).

    `tries_left` after this one; `begun_cpu_s` is what the process had used when it claimed, None where another speaks;
    `begins_run`: its run has not begun yet.
    """

    job_id: str
    root_id: str
    sequence_id: str | None
    kind: str
    attempt: int
    arguments: dict[str, Any]
    tries_left: int = 0
    begun_cpu_s: float | None = None
    origin: JobOrigin = JobOrigin()
    begins_run: bool = False


def claim(session: Session, queue: str) -> Claim | None:
    """Take the next ready job of `queue`; None when there is none, or when the queue is paused."""
    found = take_next(session, queue)
    if found is None:
        return None
    job, state_of_run = found
    begun_ns = job.started_ns or now_ns()
    session.add(JobAttempt(job_id=job.id, number=job.attempt, worker=worker_name(), started_ns=begun_ns))
    at = (job.id, job.root_id, job.sequence_id, job.kind, job.attempt)
    waited_s = None if job.ready_ns is None else max(begun_ns - job.ready_ns, 0) / 1e9
    origin = JobOrigin(job.traceparent, job.request_id, waited_s)
    begins_run = job.id != job.root_id and state_of_run != "running"
    return Claim(*at, dict(job.arguments), job.attempts_left, used_cpu_s(), origin, begins_run)


def worker_name() -> str:
    """Host and pid: enough for an administrator to find the process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def start_run(session: Session, taken: Claim) -> None:
    """Note that the run of this job has begun, where `begins_run`.

    A transaction of its own: with the job's row still locked, it would wait crosswise for somebody who cancels the run.
    """
    waiting = update(Job).where(Job.id == taken.root_id, Job.queue == "", Job.state == "queued")
    rows_changed(session, waiting.values(state="running", started_ns=now_ns(), revision=Job.revision + 1))
