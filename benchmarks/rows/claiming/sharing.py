"""The throughput of many claiming processes on one database: empty jobs, claimed and ended by the real code at full
speed.

**Conventions.** Processes and database share the machine, so a separate database has a higher throughput. Each process
has one connection, like a worker for its jobs. Counts are PostgreSQL's (`pg_stat_database`).
"""

import logging
import os
import signal
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import psycopg
import structlog
from sqlalchemy import func, select, text

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
START_S = 15.0
"""Excludes the loading and preparation of processes at their first jobs."""


@dataclass(frozen=True)
class DatabaseShare:
    """The throughput of `processes` within `lasted_s`; `database_cpu_s` is PostgreSQL's processor time."""

    processes: int
    lasted_s: float
    jobs: int
    transactions: int
    database_cpu_s: float


def shared(processes: int, lasted_s: float, runs: int) -> DatabaseShare:
    """Let `processes` processes claim for `lasted_s` from a queue of `runs` runs."""
    options = {"max_connections": str(processes + 50), "shared_buffers": "256MB"}
    with tempfile.TemporaryDirectory() as folder, running_postgres(**options) as postgres:
        settings = Settings(data_folder=Path(folder), database=DatabaseSettings(postgres.url(), pool_size=1))
        upgrade(settings)
        platform = open_silent_platform(settings)
        _fill(platform, runs)
        platform.database.close()
        pids = [_claiming(settings) for _ in range(processes)]
        time.sleep(START_S)
        _analyse(platform)  # statements on attempts were planned for an empty table
        before, cpu_s, begun, begun_s = (
            _transactions(postgres),
            _cpu_s(postgres),
            _done(platform),
            time.monotonic(),
        )
        time.sleep(lasted_s)
        took_s, done = time.monotonic() - begun_s, _done(platform) - begun
        counted, used_s = _transactions(postgres) - before, _cpu_s(postgres) - cpu_s
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        platform.database.close()
        return DatabaseShare(processes, took_s, done, counted, used_s)


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
    _analyse(platform)


def _analyse(platform: Platform) -> None:
    """Update the statistics, as a database in use does automatically."""
    with platform.database.transaction() as session:
        session.execute(text("ANALYZE"))


def _claiming(settings: Settings) -> int:
    """Start a process that runs jobs until it is killed; return its pid."""
    if (pid := os.fork()) != 0:
        return pid
    try:
        structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
        platform = open_silent_platform(settings)
        while True:
            run_row(platform, QUEUE, {KIND: _nothing}, lambda: True)
    finally:
        os._exit(1)


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
    """Return the processor time of the server and of all its processes, including ended ones, s."""
    server = psutil.Process(postgres.pid)
    alive = sum(sum(child.cpu_times()[:2]) for child in server.children())
    return float(sum(server.cpu_times()[:4]) + alive)
