"""Queues and worker processes as an administrator sees them.

**Conventions.** Ages of jobs and minutes of throughput are by the clocks that wrote them; they are for people.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from redis import RedisError
from sqlalchemy import ColumnElement, and_, case, func, select
from sqlalchemy.orm import Session

from api.schemas.admin import QueueItem, RunningAttempt, WorkerItem
from api.schemas.base import instant
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.wakeup import wake_up_counter
from services.runtime.jobs.worker_presence import WorkerPresence, running_attempts, workers_seen
from services.runtime.orm import Job, JobAttempt, Queue
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import Settings

MOST_WORKERS = 500
MINUTES, LATELY = 30, 15
MINUTE_NS = 60 * 10**9
MOST_ENDED = 200_000

WakeUpCounts = Mapping[str, int | None]
UNASKED: WakeUpCounts = dict.fromkeys(QUEUES)
NOTHING = (0,) * MINUTES


@dataclass(frozen=True)
class QueueBacklog:
    """The jobs of a queue that have not ended."""

    ready: int = 0
    waiting: int = 0
    running: int = 0
    oldest_ns: int | None = None


@dataclass(frozen=True)
class EndedJobCounts:
    """Jobs that ended, in each of the last minutes."""

    succeeded: Sequence[int] = NOTHING
    failed: Sequence[int] = NOTHING


def pending_wake_ups_of(platform: Platform) -> WakeUpCounts:
    """Wake-ups not yet received, by queue; None where the broker does not answer."""
    count = wake_up_counter(platform.settings)
    try:
        return {name: count(name) for name in QUEUES}
    except (RedisError, OSError):
        return UNASKED


def queue_items(session: Session, wake_ups: WakeUpCounts = UNASKED) -> list[QueueItem]:
    """Each queue with its switch, its jobs and what it achieved lately: three statements."""
    at_ns = now_ns()
    modes = dict(session.execute(select(Queue.name, Queue.mode)).all())
    standing, ended = _backlogs(session), _ended_counts(session, at_ns)
    return [
        QueueItem(
            name=name,
            mode=modes.get(name, "open"),
            bells=wake_ups[name],
            **_backlog_facts(standing.get(name, QueueBacklog()), at_ns),
            **_achieved(ended.get(name, EndedJobCounts())),
        )
        for name in QUEUES
    ]


def worker_items(session: Session, settings: Settings) -> list[WorkerItem]:
    """The processes that tell of themselves, silent ones first, each with what it holds."""
    busy = {attempt.worker: (job, attempt) for job, attempt in running_attempts(session, MOST_WORKERS)}
    seen = workers_seen(session, settings.jobs.heartbeat_s, MOST_WORKERS)
    return [_worker(one, busy.get(one.worker.name)) for one in seen]


def running_items(session: Session) -> list[RunningAttempt]:
    return [
        RunningAttempt(job_id=job.id, kind=job.kind, attempt=attempt.number, worker=attempt.worker)
        for job, attempt in running_attempts(session, MOST_WORKERS)
    ]


def _backlog_facts(standing: QueueBacklog, at_ns: int) -> dict[str, Any]:
    oldest_s = None if standing.oldest_ns is None else max(0, at_ns - standing.oldest_ns) / 1e9
    counts = {name: getattr(standing, name) for name in ("ready", "waiting", "running")}
    return {**counts, "oldest_ready_s": oldest_s}


def _achieved(ended: EndedJobCounts) -> dict[str, Any]:
    lately = {"succeeded_lately": sum(ended.succeeded[-LATELY:]), "failed_lately": sum(ended.failed[-LATELY:])}
    return {**lately, "per_minute": list(ended.succeeded)}


def _backlogs(session: Session) -> dict[str, QueueBacklog]:
    def counted(*claims: ColumnElement[bool]) -> ColumnElement[int]:
        return func.sum(case((and_(*claims), 1), else_=0))

    is_ready = and_(Job.state == "queued", Job.needs_left == 0)
    blocked = counted(Job.state == "queued", Job.needs_left > 0)
    oldest_ns = func.min(case((is_ready, Job.created_ns)))
    found = (
        select(Job.queue, counted(is_ready), blocked, counted(Job.state == "running"), oldest_ns)
        .where(Job.queue.in_(QUEUES), Job.state.in_(("queued", "running")))
        .group_by(Job.queue)
    )
    return {queue: QueueBacklog(*counts) for queue, *counts in session.execute(found)}


def _ended_counts(session: Session, at_ns: int) -> dict[str, EndedJobCounts]:
    since_ns = at_ns - MINUTES * MINUTE_NS
    lately = (  # a query of its own, in the index's order: without statistics SQLite would read the whole table
        select(Job.queue, Job.state, Job.finished_ns)
        .where(Job.finished_ns >= since_ns)
        .order_by(Job.finished_ns.desc())
        .limit(MOST_ENDED)
        .subquery()
    )
    minute = ((lately.c.finished_ns - since_ns) // MINUTE_NS).label("minute")
    found = select(lately.c.queue, lately.c.state, minute, func.count()).group_by(*lately.c[:2], minute)
    counts: dict[str, dict[str, list[int]]] = {}
    for queue, state, number, count in session.execute(found):
        place = min(number or 0, MINUTES - 1)  # a clock of another machine may be ahead
        counts.setdefault(queue, {}).setdefault(state, [0] * MINUTES)[place] += count
    return {
        queue: EndedJobCounts(by.get("succeeded", NOTHING), by.get("failed", NOTHING)) for queue, by in counts.items()
    }


def _worker(seen: WorkerPresence, held: tuple[Job, JobAttempt] | None) -> WorkerItem:
    row = seen.worker
    sizes = ("held_bytes", "memory_free_bytes", "memory_bytes", "disk_free_bytes", "disk_bytes")
    return WorkerItem(
        name=row.name,
        queues=row.queues.split(","),
        is_silent=seen.is_silent,
        age_s=seen.age_s,
        started_at=instant(row.started_ns),
        job_id=held[0].id if held else None,
        kind=held[0].kind if held else None,
        attempt=held[1].number if held else None,
        **{name: getattr(row, name) for name in sizes},
    )
