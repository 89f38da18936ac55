"""The database requests of a real labelling: a recording through API, sweeper and workers on a real PostgreSQL.

**Conventions.** Counts cover the workers' own transactions, from the run's start to its end, and those of the same
processes while idle. Playback is created too, so that a run has every kind of job. Logging a statement costs PostgreSQL
as much as running it, so processor time is measured in a run without logging.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg
from sqlalchemy import select

from benchmarks.rows.claiming.server_log import LOGGING, transactions
from services.runtime.access import roles
from services.runtime.access.tokens import issue
from services.runtime.access.users import create_user
from services.runtime.database.migrate import upgrade
from services.runtime.embedded.supervisor import environment_of
from services.runtime.orm import Job, Worker
from services.runtime.platform import Platform, open_silent_platform
from services.runtime.settings import ApiSettings, BrokerSettings, DatabaseSettings, Settings
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.bags import hashed_bag
from stone_client.server.job_following import follow
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run
from testing.servers.postgres import PostgresServer, running_postgres
from testing.servers.process import ServerProcess, answers, free_port
from testing.servers.redis import running_redis

WORKER = "worker"
PROGRAMS = {
    "api": ("services.runtime.processes.api",),
    "sweeper": ("services.maintenance.sweeper",),
    WORKER: ("services.runtime.processes.worker", "ingest", "labeler", "eval"),
}
START_S = 240.0


@dataclass(frozen=True)
class DatabaseLoad:
    """The requests of `processes` worker processes to the database within `lasted_s`: transactions and statements."""

    processes: int
    lasted_s: float
    transactions: dict[str, int]
    statements: dict[str, int]

    def transactions_per_s(self) -> float:
        """Return the transactions per second of one process."""
        return sum(self.transactions.values()) / self.lasted_s / self.processes


@dataclass(frozen=True)
class RunCost:
    """The requests of a run with `job_s` (seconds of each job), and of idle processes.

    `cpu_s_a_job` is the processor time of the server processes of the workers, from another run without logging.
    """

    idle: DatabaseLoad
    run: DatabaseLoad
    job_s: tuple[float, ...]
    cpu_s_a_job: float

    @property
    def jobs(self) -> int:
        return len(self.job_s)


def counted(bags: Sequence[Path], workers: int, idle_s: float) -> RunCost:
    """Label the bags one after the other with `workers` worker processes; before the last two they idle for `idle_s`.

    The last two are counted, the last one by its processor time: connections and prepared statements are then warm, as
    in a worker with history.
    """
    with running_postgres(**LOGGING) as postgres, _platform(postgres, workers) as (platform, url):
        with platform.database.transaction() as session:
            user = create_user(session, "benchmark", "curator")
            token = issue(session, user, "benchmark", roles.SCOPES_OF[user.role], 86_400.0)
        with Api(Server(url, token)) as api:
            for bag in bags[:-2]:
                _labelled(api, _uploaded(api, bag))
            sequence = _uploaded(api, bags[-2])
            with _loaded(postgres, workers) as idle:
                time.sleep(idle_s)
            with _loaded(postgres, workers) as run:
                run_id = _labelled(api, sequence)
            cpu_s, jobs = _cpu_s_unlogged(api, postgres, bags[-1], platform)
        return RunCost(idle[0], run[0], _job_s(platform, run_id), cpu_s / jobs)


def recording(folder: Path, seconds: float) -> Path:
    """Return a simulated recording, created once."""
    folder.mkdir(parents=True, exist_ok=True)
    bag = folder / f"claiming-{seconds:g}.mcap"
    if not bag.exists():
        simulate(bag, SimulateOptions(seconds))
    return bag


def _uploaded(api: Api, bag: Path) -> Mapping[str, Any]:
    """Return a new sequence, named after the bag."""
    sequence = ensure_sequence(api, bag.stem.replace(".", "-"))
    pin_calibration(api, sequence, calibration_path(bag))
    add_recording(api, sequence, hashed_bag(bag, _silent), _silent)
    return sequence


def _labelled(api: Api, sequence: Mapping[str, Any]) -> str:
    """Return the id of the run that labelled it."""
    run_id: str = start_run(api, sequence, {})["id"]
    follow(api, run_id, _silent)
    return run_id


def _cpu_s_unlogged(api: Api, postgres: PostgresServer, bag: Path, platform: Platform) -> tuple[float, int]:
    """Return the server's processor time for the workers while they labelled the bag without logging, s; and their
    jobs.
    """
    sequence = _uploaded(api, bag)
    postgres.run("ALTER SYSTEM SET log_statement TO 'none'")
    postgres.run("SELECT pg_reload_conf()")
    begun_s = _cpu_s_for(WORKER, postgres)
    run_id = _labelled(api, sequence)
    return _cpu_s_for(WORKER, postgres) - begun_s, len(_job_s(platform, run_id))


@contextmanager
def _loaded(postgres: PostgresServer, processes: int) -> Iterator[list[DatabaseLoad]]:
    """Yield a list that contains, after the end, the workers' requests during the block."""
    loads: list[DatabaseLoad] = []
    with postgres.log.open(errors="replace") as log:
        log.seek(0, 2)
        begun_s = time.monotonic()
        yield loads
        lasted_s = time.monotonic() - begun_s
        of_workers = [transaction for transaction in transactions(log) if transaction.program == WORKER]
    purposes, statements = Counter(transaction.purpose for transaction in of_workers), Counter[str]()
    for transaction in of_workers:
        statements[transaction.purpose] += len(transaction.statements)
    loads.append(DatabaseLoad(processes, lasted_s, dict(purposes), dict(statements)))


def _cpu_s_for(program: str, postgres: PostgresServer) -> float:
    """Return the processor time of the server's processes for a program, s; to the nanosecond, since it is little."""
    with psycopg.connect(postgres.url()) as connection:
        query = "SELECT pid FROM pg_stat_activity WHERE application_name = %s"
        pids = [row[0] for row in connection.execute(query, [program]).fetchall()]
    return sum(int(Path(f"/proc/{pid}/schedstat").read_text("ascii").split()[0]) for pid in pids) / 1e9


@contextmanager
def _platform(postgres: PostgresServer, workers: int) -> Iterator[tuple[Platform, str]]:
    """Yield a platform of separate processes, each with its name in the database; and the address of its API."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="stone-claiming-")))
        redis = stack.enter_context(running_redis())
        port = free_port()
        settings = Settings(
            data_folder=folder / "data",
            workers=workers,
            database=DatabaseSettings(postgres.url()),
            broker=BrokerSettings(redis.url),
            api=ApiSettings(host="127.0.0.1", port=port, url=f"http://127.0.0.1:{port}", pages=False),
        )
        upgrade(settings)
        platform = open_silent_platform(settings)
        stack.callback(platform.database.close)
        stack.enter_context(_process(settings, folder / "api", lambda: answers(port)))
        for name in ("sweeper", WORKER):
            stack.enter_context(_process(settings, folder / name, lambda: True))
        _await_workers(platform, workers)
        yield platform, settings.api.url


@contextmanager
def _process(settings: Settings, folder: Path, is_ready: Callable[[], bool]) -> Iterator[None]:
    folder.mkdir()
    command = [sys.executable, "-P", "-m", *PROGRAMS[folder.name]]
    environment = {**environment_of(settings), "PGAPPNAME": folder.name}
    server = ServerProcess(command, folder, is_ready, environment=environment, patience_s=START_S)
    server.start()
    try:
        yield
    finally:
        server.stop()


def _await_workers(platform: Platform, workers: int) -> None:
    until_s = time.monotonic() + START_S
    while True:
        with platform.database.reading() as session:
            here = len(session.scalars(select(Worker.name)).all())
        if here >= workers:
            return
        if time.monotonic() > until_s:
            raise TimeoutError(f"{here} of {workers} worker processes were there within {START_S:g} s")
        time.sleep(0.2)


def _job_s(platform: Platform, run_id: str) -> tuple[float, ...]:
    with platform.database.reading() as session:
        jobs = session.scalars(select(Job).where(Job.root_id == run_id, Job.queue != "")).all()
    return tuple(((job.finished_ns or 0) - (job.started_ns or 0)) / 1e9 for job in jobs)


def _silent(_stage: str, _done: int, _total: int) -> None:
    return
