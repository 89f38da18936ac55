"""What many claiming processes get of one database: empty jobs, claimed and ended by the real code, as fast as it goes.

**Conventions.** Processes and database share the machine, so a database of its own gives more. Each process has one
connection, as a worker's has one for its jobs. Counted is what PostgreSQL counted (`pg_stat_database`).
"""

import os
import signal
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import psutil
import psycopg
from sqlalchemy import func, select

from services.runtime.database.migrate import upgrade
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.execution import run_row
from services.runtime.jobs.specs import Attempt, Context, JobSpec, Outcome
from services.runtime.orm import Job, User
from services.runtime.platform import Platform, open_silent_platform
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.postgres import PostgresServer, running_postgres

QUEUE, KIND = "ingest", "ingest.nothing"
OWNERS, JOBS_A_RUN = 8, 40


@dataclass(frozen=True)
class DatabaseShare:
    """What `processes` got within `lasted_s`; `database_cpu_s` is what PostgreSQL used for it."""

    processes: int
    lasted_s: float
    jobs: int
    transactions: int
    database_cpu_s: float


def shared(processes: int, lasted_s: float, runs: int) -> DatabaseShare:
    """Have so many processes claim for so long from a queue of so many runs."""
    options = {"max_connections": str(processes + 50), "shared_buffers": "256MB"}
    with tempfile.TemporaryDirectory() as folder, running_postgres(**options) as postgres:
        settings = Settings(data_folder=Path(folder), database=DatabaseSettings(postgres.url(), pool_size=1))
        upgrade(settings)
        platform = open_silent_platform(settings)
        _fill(platform, runs)
        platform.database.close()
        before, cpu_s = _transactions(postgres), _cpu_s(postgres)
        begun_s = time.monotonic()
        pids = [_claiming(settings, begun_s + lasted_s) for _ in range(processes)]
        for pid in pids:
            os.waitpid(pid, 0)
        took_s = time.monotonic() - begun_s
        time.sleep(1.0)  # PostgreSQL reaps the servers of those that ended
        done = _done(platform)
        platform.database.close()
        counted = _transactions(postgres) - before
        return DatabaseShare(processes, took_s, done, counted, _cpu_s(postgres) - cpu_s)


def _fill(platform: Platform, runs: int) -> None:
    with platform.database.transaction() as session:
        owners = [User(name=f"owner-{number}", role="curator") for number in range(OWNERS)]
        session.add_all(owners)
        session.flush()
        ids = [owner.id for owner in owners]
    for number in range(runs):
        with platform.database.transaction() as session:
            specs = [JobSpec(KIND)] * JOBS_A_RUN
            enqueue_run(session, "benchmark", specs, Context(ids[number % OWNERS]))


def _claiming(settings: Settings, until_s: float) -> int:
    """A process that runs jobs until then; its pid."""
    if (pid := os.fork()) != 0:
        return pid
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        quiet = settings.model_copy(update={"jobs": replace(settings.jobs, rest_s=0.01)})
        platform = open_silent_platform(quiet)
        while time.monotonic() < until_s:
            run_row(platform, QUEUE, {KIND: _nothing}, lambda: time.monotonic() < until_s)
        platform.database.close()
    finally:
        os._exit(0)


def _nothing(_attempt: Attempt) -> Outcome:
    return Outcome()


def _done(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).where(Job.kind == KIND, Job.state == "succeeded")) or 0


def _transactions(postgres: PostgresServer) -> int:
    with psycopg.connect(postgres.url()) as connection:
        row = connection.execute(
            "SELECT xact_commit + xact_rollback FROM pg_stat_database WHERE datname = 'postgres'"
        ).fetchone()
    return int(row[0]) if row else 0


def _cpu_s(postgres: PostgresServer) -> float:
    """Of the server and of all its processes, those that ended included."""
    server = psutil.Process(postgres.pid)
    alive = sum(sum(child.cpu_times()[:2]) for child in server.children())
    return float(sum(server.cpu_times()[:4]) + alive)
