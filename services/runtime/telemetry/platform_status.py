"""The platform's status for monitoring: waiting jobs and their age, workers, chores.

**Conventions.** Queries stay cheap at any size: counting stops at `MOST`, so a figure of `MOST` means "at least". Ended
jobs are counted only by the processes that ended them. Predicates of partial indexes are literals (`orm/jobs.py`). Ages
use the database's clock if the database wrote the time, else the local clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import ColumnElement, func, literal_column, select, text
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.worker_presence import WorkerPresence, workers_seen
from services.runtime.orm import ChoreRow, FigureRow, Job, Queue, Upload
from services.runtime.orm.base import now_ns
from services.runtime.orm.jobs import IS_READY, IS_RUNNING, IS_WAITING
from services.runtime.store.faults import ScrubStatus, scrub_status
from services.runtime.uploads.rows import is_waiting

MOST = 10_000
MOST_WORKERS = 5_000
STATES = (("ready", IS_READY), ("waiting", IS_WAITING), ("running", IS_RUNNING))
ONE: ColumnElement[int] = literal_column("1")


@dataclass(frozen=True)
class PlatformStatus:
    """The status: `jobs` by (queue, state), with the states ready, waiting, running; ages in seconds."""

    jobs: Mapping[tuple[str, str], int]
    oldest_ready_s: Mapping[str, float]
    paused: frozenset[str]
    uploads_open: int
    workers: tuple[WorkerPresence, ...]
    chores_s: Mapping[str, float]
    figures: Mapping[str, int]
    scrub: ScrubStatus


def platform_status(session: Session, heartbeat_s: float) -> PlatformStatus:
    """Return the current platform status with every queue, also empty ones."""
    return PlatformStatus(
        jobs={key: count for state, predicate in STATES for key, count in _count(session, state, predicate).items()},
        oldest_ready_s={queue: _oldest_s(session, queue) for queue in QUEUES},
        paused=frozenset(session.scalars(select(Queue.name).where(Queue.mode == "paused"))),
        uploads_open=_uploads_open(session),
        workers=tuple(workers_seen(session, heartbeat_s, MOST_WORKERS)),
        chores_s={name: age / 1e9 for name, age in session.execute(select(ChoreRow.name, _age()))},
        scrub=scrub_status(session),
        figures=dict(session.execute(select(FigureRow.name, FigureRow.value)).all()),
    )


def _age() -> ColumnElement[int]:
    return database_ns() - ChoreRow.done_ns


def _count(session: Session, state: str, predicate: str) -> dict[tuple[str, str], int]:
    """Return the number of jobs by queue, from the partial index of this predicate."""
    counts = {}
    for queue in QUEUES:
        some = select(ONE).select_from(Job).where(Job.queue == queue, text(predicate)).limit(MOST).subquery()
        counts[queue, state] = session.scalar(select(func.count()).select_from(some)) or 0
    return counts


def _oldest_s(session: Session, queue: str) -> float:
    """Return the age of the longest ready job in seconds; 0 if there is none."""
    since_ns = session.scalar(select(func.min(Job.ready_ns)).where(Job.queue == queue, text(IS_READY)))
    return 0.0 if since_ns is None else max(now_ns() - since_ns, 0) / 1e9


def _uploads_open(session: Session) -> int:
    some = select(ONE).select_from(Upload).where(is_waiting(), Upload.state == "open").limit(MOST).subquery()
    return session.scalar(select(func.count()).select_from(some)) or 0
