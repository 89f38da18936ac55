"""Jobs as their administrator sees them: with names, counted by state, and a run's jobs along time."""

from collections.abc import Mapping, Sequence
from collections.abc import Sequence as Listing
from dataclasses import dataclass
from typing import Any

from redis import RedisError
from sqlalchemy import ColumnElement, Select, and_, case, func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from api.schemas.admin import AdminJobDetail, AdminJobItem, JobCounts, QueueItem, RunningAttempt, WorkerItem
from api.views.jobs import job_detail, job_items
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.wakeup import wake_up_counter
from services.runtime.jobs.worker_presence import WorkerPresence, running_attempts, workers_seen
from services.runtime.orm import Job, JobAttempt, Queue, SequenceRow, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import Settings

MOST_CHILDREN = 200
MOST_SPANS = 2000
LOOKED_AT = 1000
NEVER_NS = 2**62
DEAD = and_(Job.queue != "", Job.state == "failed", Job.attempts_left <= 0)
"""Jobs that failed after all their attempts; a job that refuses its input fails at once and would fail again."""


@dataclass(frozen=True)
class JobSpan:
    """When a job of a run was worked on; `finished_ns` is None while it is not over."""

    job_id: str
    kind: str
    state: str
    attempt: int
    created_ns: int
    started_ns: int | None
    finished_ns: int | None


def admin_job_items(session: Session, jobs: Listing[Job]) -> list[AdminJobItem]:
    """Return jobs as the administrator's list shows them; two statements read all names."""
    owners = _names(session, User.id, User.name, {job.owner_id for job in jobs})
    sequences = _names(session, SequenceRow.id, SequenceRow.name, {job.sequence_id for job in jobs if job.sequence_id})
    return [
        AdminJobItem(
            **dict(item),
            owner=owners.get(job.owner_id, ""),
            sequence=sequences.get(job.sequence_id or ""),
            attempts_left=job.attempts_left if job.queue else 0,
        )
        for job, item in zip(jobs, job_items(session, jobs), strict=True)
    ]


def admin_job_detail(session: Session, job: Job) -> AdminJobDetail:
    """Return a job with its attempts; for a run also its jobs, unsuccessful ones first, then by start."""
    children = (Job.root_id == job.id, Job.id != job.id)
    unfinished_first = case((Job.state == "succeeded", 1), else_=0)
    in_time = (unfinished_first, func.coalesce(Job.started_ns, NEVER_NS), Job.id)
    shown = select(Job).where(*children).order_by(*in_time).limit(MOST_CHILDREN)
    sequences = _names(session, SequenceRow.id, SequenceRow.name, {job.sequence_id} if job.sequence_id else set())
    return AdminJobDetail(
        **dict(job_detail(session, job)),
        owner=session.get_one(User, job.owner_id).name,
        sequence=sequences.get(job.sequence_id or ""),
        children=job_items(session, session.scalars(shown).all()),
        children_total=session.scalar(select(func.count()).select_from(Job).where(*children)) or 0,
    )


def job_counts(session: Session, levelled: Select[Job], flat: Select[Job]) -> JobCounts:
    """Return the number of jobs by state among those that a list may show."""
    by_state = levelled.with_only_columns(Job.state, func.count()).group_by(Job.state)
    counts = {state: count for state, count in session.execute(by_state)}
    dead = session.scalar(flat.with_only_columns(func.count()).where(DEAD)) or 0
    return JobCounts(**counts, dead=dead)


def late_kinds(session: Session) -> list[str]:
    """Return the kinds among the newest jobs, by name, as suggestions for a filter."""
    newest = select(Job.kind).order_by(Job.id.desc()).limit(LOOKED_AT).subquery()
    return sorted(session.scalars(select(newest.c.kind).distinct()))


def job_spans_of(session: Session, job: Job) -> list[JobSpan]:
    """Return the jobs of a run in the order of creation; for a single job, itself."""
    columns = (Job.id, Job.kind, Job.state, Job.attempt, Job.created_ns, Job.started_ns, Job.finished_ns)
    spans = select(*columns).where(Job.root_id == job.id, Job.queue != "").order_by(Job.id).limit(MOST_SPANS)
    return [JobSpan(*row) for row in session.execute(spans)]


def _names(
    session: Session, key: InstrumentedAttribute[str], name: InstrumentedAttribute[str], ids: set[str]
) -> Mapping[str, str]:
    return dict(session.execute(select(key, name).where(key.in_(ids))).all()) if ids else {}


# Queues and worker processes as an administrator sees them.
#
# **Conventions.** Ages of jobs and minutes of throughput are by the clocks that wrote them; they are for people.


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
    """Return the wake-ups not yet received, by queue; None if the broker does not respond."""
    count = wake_up_counter(platform.settings)
    try:
        return {name: count(name) for name in QUEUES}
    except (RedisError, OSError):
        return UNASKED


def queue_items(session: Session, wake_ups: WakeUpCounts = UNASKED) -> list[QueueItem]:
    """Return each queue with its switch, its jobs and its recent results, by three statements."""
    at_ns = now_ns()
    modes = dict(session.execute(select(Queue.name, Queue.mode)).all())
    standing, ended = _backlogs(session), _ended_counts(session, at_ns)
    return [
        QueueItem.of(
            standing.get(name, QueueBacklog()),
            name=name,
            mode=modes.get(name, "open"),
            wake_ups=wake_ups[name],
            oldest_ready_s=_age_s(standing.get(name, QueueBacklog()), at_ns),
            **_achieved(ended.get(name, EndedJobCounts())),
        )
        for name in QUEUES
    ]


def worker_items(session: Session, settings: Settings) -> list[WorkerItem]:
    """Return the processes with heartbeats, silent ones first, each with its resources."""
    busy = {attempt.worker: (job, attempt) for job, attempt in running_attempts(session, MOST_WORKERS)}
    seen = workers_seen(session, settings.jobs.heartbeat_s, MOST_WORKERS)
    return [_worker(presence, busy.get(presence.worker.name)) for presence in seen]


def running_items(session: Session) -> list[RunningAttempt]:
    return [
        RunningAttempt(job_id=job.id, kind=job.kind, attempt=attempt.number, worker=attempt.worker)
        for job, attempt in running_attempts(session, MOST_WORKERS)
    ]


def _age_s(standing: QueueBacklog, at_ns: int) -> float | None:
    return None if standing.oldest_ns is None else max(0, at_ns - standing.oldest_ns) / 1e9


def _achieved(ended: EndedJobCounts) -> dict[str, Any]:
    lately = {"succeeded_lately": sum(ended.succeeded[-LATELY:]), "failed_lately": sum(ended.failed[-LATELY:])}
    return {**lately, "per_minute": list(ended.succeeded)}


def _backlogs(session: Session) -> dict[str, QueueBacklog]:
    def counted(*claims: ColumnElement[bool]) -> ColumnElement[int]:
        return func.sum(case((and_(*claims), 1), else_=0))

    is_ready = and_(Job.state == "queued", Job.needs_left == 0)
    blocked = counted(Job.state == "queued", Job.needs_left > 0)
    oldest_ns = func.min(case((is_ready, Job.created_ns)))
    counts_by_queue = (
        select(Job.queue, counted(is_ready), blocked, counted(Job.state == "running"), oldest_ns)
        .where(Job.queue.in_(QUEUES), Job.state.in_(("queued", "running")))
        .group_by(Job.queue)
    )
    return {queue: QueueBacklog(*counts) for queue, *counts in session.execute(counts_by_queue)}


def _ended_counts(session: Session, at_ns: int) -> dict[str, EndedJobCounts]:
    since_ns = at_ns - MINUTES * MINUTE_NS
    lately = (  # a separate query in the index's order: without statistics SQLite would read the whole table
        select(Job.queue, Job.state, Job.finished_ns)
        .where(Job.finished_ns >= since_ns)
        .order_by(Job.finished_ns.desc())
        .limit(MOST_ENDED)
        .subquery()
    )
    minute = ((lately.c.finished_ns - since_ns) // MINUTE_NS).label("minute")
    counts_by_minute = select(lately.c.queue, lately.c.state, minute, func.count()).group_by(*lately.c[:2], minute)
    counts: dict[str, dict[str, list[int]]] = {}
    for queue, state, number, count in session.execute(counts_by_minute):
        index = min(number or 0, MINUTES - 1)  # a clock of another machine may be ahead
        counts.setdefault(queue, {}).setdefault(state, [0] * MINUTES)[index] += count
    return {
        queue: EndedJobCounts(by.get("succeeded", NOTHING), by.get("failed", NOTHING)) for queue, by in counts.items()
    }


def _worker(seen: WorkerPresence, held: tuple[Job, JobAttempt] | None) -> WorkerItem:
    row = seen.worker
    return WorkerItem.of(
        row,
        queues=row.queues.split(","),
        is_silent=seen.is_silent,
        age_s=seen.age_s,
        job_id=held[0].id if held else None,
        kind=held[0].kind if held else None,
        attempt=held[1].number if held else None,
    )
