"""Claims the next job of a queue: most urgent first, then the owner with the fewest running jobs, then the oldest
run.
"""

import os
import socket
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, bindparam, exists, func, literal_column, select, update
from sqlalchemy.orm import Session, aliased
from sqlalchemy.sql.dml import ReturningUpdate
from sqlalchemy.sql.selectable import CTE

from services.runtime.database.rows import KeptSelect
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import Job, JobAttempt, Queue
from services.runtime.orm.base import now_ns
from services.runtime.telemetry.process_usage import used_cpu_s


@dataclass(frozen=True)
class JobOrigin:
    """The origin of a job, and how long it was ready before its claim (None: unknown)."""

    traceparent: str = ""
    request_id: str = ""
    waited_s: float | None = None


@dataclass(frozen=True)
class Claim:
    """A claimed job: only this process holds this (job, attempt).

    - `tries_left`: after this attempt
    - `begun_cpu_s`: CPU time of the process at the claim, None if another process reports it
    - `begins_run`: the run has not started yet
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
    """Claim the next ready job of `queue`; None if there is none, or if the queue is paused."""
    taken = take_next(session, queue)
    if taken is None:
        return None
    job, state_of_run = taken
    begun_ns = job.started_ns or now_ns()
    session.add(JobAttempt(job_id=job.id, number=job.attempt, worker=worker_name(), started_ns=begun_ns))
    at = (job.id, job.root_id, job.sequence_id, job.kind, job.attempt)
    waited_s = None if job.ready_ns is None else max(begun_ns - job.ready_ns, 0) / 1e9
    origin = JobOrigin(job.traceparent, job.request_id, waited_s)
    begins_run = job.id != job.root_id and state_of_run != "running"
    return Claim(*at, dict(job.arguments), job.attempts_left, used_cpu_s(), origin, begins_run)


def worker_name() -> str:
    """Return host and pid, with which an administrator finds the process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def start_run(session: Session, taken: Claim) -> None:
    """Record that the run of this job has started, if `begins_run`.

    Needs its own transaction: with the job's row still locked, it could deadlock with a cancellation of the run.
    """
    waiting = update(Job).where(Job.id == taken.root_id, Job.queue == "", Job.state == "queued")
    rows_changed(session, waiting.values(state="running", started_ns=now_ns(), revision=Job.revision + 1))


# Finds and takes the next ready job of a queue by index, however many jobs wait. First it finds the owners with a ready
# job by hopping along the index, with the urgency of their most urgent job and the number of their running jobs. Then
# it takes the oldest job of the first owner that is not being taken (`SKIP LOCKED` on PostgreSQL; SQLite has one writer
# at a time). With equal urgency the older run goes first, so that runs finish before others start. Predicates of
# partial indexes are literals (`orm/jobs.py`).


MOST_WAKE_UPS = 10_000
"""More wake-ups than this per queue are useless: the sweeper sends others as they are received."""
MOST_QUEUES = 64
"""Statements are cached for this many queues: compiling one takes longer than running it."""
QUEUED: ColumnElement[str] = literal_column("'queued'")
RUNNING: ColumnElement[str] = literal_column("'running'")
NONE: ColumnElement[int] = literal_column("0")
ONE: ColumnElement[int] = literal_column("1")
"""A literal, because PostgreSQL plans a statement with an unknown LIMIT again at each execution."""


def take_next(session: Session, queue: str) -> tuple[Job, str] | None:
    """Take the next job of `queue`; return it and the state of its run (its own if it is a run).

    None if the queue is paused, or if all ready jobs are being taken.
    """
    session.flush()  # cached statements see only flushed rows
    now = {"now": now_ns()}
    if (row := session.execute(_taking_of_first(queue), now).first()) is not None:
        return row[0], row[1]
    owners = _owners_served(queue).rows(session, {})
    for owner_id, priority, _running, _oldest in owners:
        row = session.execute(_taking_of_owner(queue), {"owner": owner_id, "urgency": priority, **now}).first()
        if row is not None:
            return row[0], row[1]
    row = session.execute(_taking(queue), now).first() if owners else None
    return None if row is None else (row[0], row[1])


def wake_ups_wanted(session: Session, queue: str) -> int:
    """Return the number of ready jobs of `queue`, at most `MOST_WAKE_UPS`."""
    return session.scalar(_counting(queue)) or 0


@lru_cache(MOST_QUEUES)
def _counting(queue: str) -> Select[int]:
    some = select(ONE).select_from(Job).where(_is_ready(Job, queue)).limit(MOST_WAKE_UPS).subquery()
    return select(func.count()).select_from(some)


def _is_ready(job: type[Job], queue: str) -> ColumnElement[bool]:
    return and_(job.queue == queue, job.state == QUEUED, job.needs_left == NONE)


@lru_cache(MOST_QUEUES)
def _taking_of_first(queue: str) -> ReturningUpdate[Job, str]:
    """Take a job as `_taking_of_owner`, for the owner whose turn it is; usually one is free."""
    turn = _served(queue).limit(ONE).cte("turn")
    owner, urgency = (select(column).scalar_subquery() for column in (turn.c.owner_id, turn.c.priority))
    return _taken(_untaken(queue, Job.owner_id == owner, Job.priority == urgency).order_by(Job.root_id, Job.id))


@lru_cache(MOST_QUEUES)
def _taking_of_owner(queue: str) -> ReturningUpdate[Job, str]:
    """Take the job of the oldest run among the jobs of `owner` with `urgency`."""
    of_owner = (Job.owner_id == bindparam("owner"), Job.priority == bindparam("urgency"))
    return _taken(_untaken(queue, *of_owner).order_by(Job.root_id, Job.id))


@lru_cache(MOST_QUEUES)
def _taking(queue: str) -> ReturningUpdate[Job, str]:
    return _taken(_untaken(queue))


def _untaken(queue: str, *claims: ColumnElement[bool]) -> Select[str]:
    free = select(Job.id).where(_is_ready(Job, queue), *claims).limit(ONE)
    return free.with_for_update(skip_locked=True, key_share=True)


def _taken(free: Select[str]) -> ReturningUpdate[Job, str]:
    """Take the selected job, at `now`; return its row, and the state of its run."""
    run = aliased(Job)
    state_of_run = select(run.state).where(run.id == Job.root_id).correlate(Job).scalar_subquery()
    taken = update(Job).where(Job.id == free.correlate(None).scalar_subquery(), Job.state == QUEUED)
    values = {"state": "running", "attempt": Job.attempt + 1, "attempts_left": Job.attempts_left - 1}
    clean = {"started_ns": bindparam("now"), "stage": "", "done": 0, "total": 0, "heartbeats": 0}
    statement = taken.values(**values, **clean, revision=Job.revision + 1).returning(Job, state_of_run)
    return statement.execution_options(populate_existing=True, synchronize_session=False)


@lru_cache(MOST_QUEUES)
def owners_waiting(queue: str) -> KeptSelect:
    """Return the statement of (owner, urgency, running jobs, oldest run), the owner whose turn it is first."""
    return KeptSelect(_owners(queue))


@lru_cache(MOST_QUEUES)
def _owners_served(queue: str) -> KeptSelect:
    return KeptSelect(_served(queue))


def _served(queue: str) -> Select[str, int, int, str]:
    """Select as `_owners`; nothing if the queue is paused."""
    return _owners(queue).where(~exists().where(Queue.name == queue, Queue.mode == "paused"))


def _owners(queue: str) -> Select[str, int, int, str]:
    heads, busy = _heads(queue).c, aliased(Job)
    at_work = select(func.count()).where(busy.queue == queue, busy.state == RUNNING, busy.owner_id == heads.owner_id)
    running = at_work.scalar_subquery().label("running")
    owners = select(heads.owner_id, heads.priority, running, heads.root_id)
    return owners.order_by(heads.priority.desc(), running, heads.root_id)


def _heads(queue: str) -> CTE:
    """Return the first ready job of every owner, most urgent and oldest run first, one index step each.

    The order names every column of that index: by the smallest run alone, PostgreSQL scans all runs that ever existed.
    """
    first, following = aliased(Job), aliased(Job)
    begin = select(first.owner_id, first.priority, first.root_id).where(first.id == _head(queue).scalar_subquery())
    heads = begin.cte(recursive=True)
    after = _head(queue, heads).correlate(heads).scalar_subquery()
    of_next = select(following.owner_id, following.priority, following.root_id)
    return heads.union_all(of_next.join_from(heads, following, following.id == after))


def _head(queue: str, after: CTE | None = None) -> Select[str]:
    """Select the id of the first ready job of the owner after the owners of `after`."""
    job = aliased(Job)
    ready = select(job.id).where(_is_ready(job, queue))
    if after is not None:
        ready = ready.where(job.owner_id > after.c.owner_id)
    return ready.order_by(job.owner_id, job.priority.desc(), job.root_id, job.id).limit(ONE)
