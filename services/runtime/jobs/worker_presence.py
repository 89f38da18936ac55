"""Worker heartbeats: one row per worker process, updated every few seconds.

**Conventions.** The rows are only for display: `services/runtime/jobs/claims.py` decides which worker holds a job,
`services/runtime/jobs/lease_sweep.py` whether an attempt is alive. Only the database's clock determines the age of a
row. Idle and busy processes send heartbeats alike. A process that ends in order deletes its row; the row of a killed
process is deleted after `FORGOTTEN_S`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Event, Thread

import structlog
from sqlalchemy import delete, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.jobs.claims import worker_name
from services.runtime.jobs.lease_keeper import PresenceLine, ProcessPresence, write_presence
from services.runtime.orm import Job, JobAttempt, Worker
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.processes.health_check import HeartbeatFile
from services.runtime.telemetry.counter_rows import CounterWriter
from services.runtime.telemetry.counters import process_counters
from services.runtime.telemetry.process_usage import disk, held_bytes, memory

FORGOTTEN_S = 3600.0
MISSED_BEATS = 4
"""A process counts as silent after this many missed heartbeats."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class WorkerPresence:
    """A process and the age of its last heartbeat."""

    worker: Worker
    age_s: float
    is_silent: bool


class WorkerHeartbeat:
    """`start()` writes at once and then every `heartbeat_s` from a thread; `leave()` deletes the row."""

    def __init__(self, platform: Platform, queues: Sequence[str]) -> None:
        self._platform = platform
        self._queues = ",".join(sorted(queues))
        self._heartbeat_file = HeartbeatFile(platform.settings.root)
        self._started_ns = now_ns()
        self._counters = CounterWriter(process_counters())
        self._line = PresenceLine(platform.settings.jobs.heartbeat_s)
        self._leaving = Event()
        self._thread = Thread(target=self._keep_writing, name="presence", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def leave(self) -> None:
        self._leaving.set()
        self._thread.join(timeout=self._platform.settings.jobs.heartbeat_s)
        self._heartbeat_file.stop()
        self._line.leave(worker_name())
        try:
            with self._platform.database.transaction() as session:
                session.execute(delete(Worker).where(Worker.name == worker_name()))
                self._counters.tell(session)
        except SQLAlchemyError as error:
            log.warning("worker presence not deleted; it will expire", reason=str(error)[:200])

    def tell(self) -> None:
        """Write the process's current row and its counters, through the worker's keeper if one answers."""
        present = self._present()
        grown, handed_over = self._counters.handed_over()
        if self._line.tell(present, grown):
            handed_over()
            return
        with self._platform.database.transaction() as session:
            write_presence(session, [present])
            counters_committed = self._counters.tell(session)
        counters_committed()

    def _present(self) -> ProcessPresence:
        ram, data = memory(), disk(self._platform.settings.root)
        rooms = (ram.free_bytes, ram.total_bytes, data.free_bytes, data.total_bytes)
        return ProcessPresence(worker_name(), self._queues, self._started_ns, held_bytes(), *rooms)

    def _keep_writing(self) -> None:
        beat_s = self._platform.settings.jobs.heartbeat_s
        while not self._leaving.is_set():
            begin_s = time.monotonic()
            self._heartbeat_file.beat()
            try:
                self.tell()
            except SQLAlchemyError as error:
                log.warning("worker presence not written; the next heartbeat writes it", reason=str(error)[:200])
            self._leaving.wait(max(0.1, beat_s - (time.monotonic() - begin_s)))


def workers_seen(session: Session, heartbeat_s: float, limit: int) -> list[WorkerPresence]:
    """Return all processes with a row, the silent ones first, then by name."""
    age_ns = (database_ns() - Worker.beat_ns).label("age_ns")
    rows = session.execute(select(Worker, age_ns).order_by(Worker.name).limit(limit)).all()
    workers = [WorkerPresence(row, max(0, age) / 1e9, age / 1e9 > MISSED_BEATS * heartbeat_s) for row, age in rows]
    return sorted(workers, key=lambda seen: (not seen.is_silent, seen.worker.name))


def forget_silent(platform: Platform, older_than_s: float = FORGOTTEN_S) -> int:
    """Delete the rows of processes silent for this long; return their number."""
    with platform.database.transaction() as session:
        gone = delete(Worker).where(Worker.beat_ns < database_ns() - int(older_than_s * 1e9))
        return session.execute(gone).rowcount  # type: ignore[attr-defined,no-any-return]


def running_attempts(session: Session, limit: int) -> list[tuple[Job, JobAttempt]]:
    """Return the jobs that a worker holds, the oldest attempt first."""
    running = (
        select(Job, JobAttempt)
        .join(JobAttempt, (JobAttempt.job_id == Job.id) & (JobAttempt.number == Job.attempt))
        .where(Job.state == "running", Job.queue != "")
        .order_by(JobAttempt.started_ns, Job.id)
        .limit(limit)
    )
    return [(job, attempt) for job, attempt in session.execute(running)]
