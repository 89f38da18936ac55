"""Workers by the hundred take jobs of one queue at once: `python -m benchmarks.rows.claiming [--workers 1 10 1000]`.

PostgreSQL holds a backlog of ready jobs of fifty owners. Each worker is a thread with a connection of its own that
claims, says that the job has ended, and claims again, with no work between: what is measured is the database alone.
Given are jobs a second, how long a claim and an ending took, and whether any job was taken twice or not at all.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier as ProcessBarrier
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Barrier, Thread

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.rows.filling import analyse, lay, numbers, prepare
from services.runtime.database import Database
from services.runtime.jobs.claiming import claim
from services.runtime.jobs.finishing import succeed
from services.runtime.jobs.specs import Outcome
from services.runtime.migrate import upgrade
from services.runtime.settings import DatabaseSettings, Settings
from tests.servers.postgres import running_postgres

KEPT = Path(__file__).parents[1] / "fleet" / "database.json"
OWNERS = 50
PROCESSES = 4
USER, JOB = 1, 3


@dataclass(frozen=True)
class Taken:
    """What so many workers did: `claims_ms` and `ends_ms` are (p50, p95, longest)."""

    workers: int
    jobs_per_s: float
    claims_ms: tuple[float, float, float]
    ends_ms: tuple[float, float, float]
    doubled: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 10, 100, 1000])
    parser.add_argument("--backlog", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each number of workers")
    parser.add_argument("--json", type=Path, default=Path("build") / "claims.json")
    parser.add_argument("--keep", action="store_true", help=f"also as {KEPT.name}, for benchmarks.fleet")
    options = parser.parse_args()
    connections = str(max(options.workers) + 50)
    found = []
    with (
        TemporaryDirectory() as folder,
        running_postgres(max_connections=connections, shared_buffers="512MB", max_wal_size="1GB") as server,
    ):
        settings = Settings(data_folder=Path(folder), database=DatabaseSettings(server.url()))
        lay_backlog(settings, options.backlog)
        for workers in options.workers:
            found.append(taken_by(server.url(), workers, options.seconds))
            Console(stderr=True).print(found[-1])
    record = {"backlog": options.backlog, "taken": [asdict(one) for one in found]}
    for path in (options.json, *((KEPT,) if options.keep else ())):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    sys.exit(_show(found, options.backlog))


def lay_backlog(settings: Settings, backlog: int) -> None:
    """So many ready jobs, each a run of its own."""
    upgrade(settings)
    database = Database(settings)
    with database.engine.connect() as opened:
        connection = opened.execution_options(isolation_level="AUTOCOMMIT")
        prepare(connection)
        people = f"generate_series(0::bigint, {OWNERS - 1}) AS n"
        lay(connection, "users", people, {"id": f"hex_id({USER}, n)", "name": "'person-' || n", "role": "'curator'"})
        lay(connection, "jobs", numbers(backlog), {
            "id": f"hex_id({JOB}, n)", "root_id": f"hex_id({JOB}, n)", "owner_id": f"hex_id({USER}, n % {OWNERS})",
            "kind": "'ingest.register'", "queue": "'ingest'", "state": "'queued'",
        })  # fmt: skip
        analyse(connection)
    database.close()


def taken_by(url: str, workers: int, seconds: float) -> Taken:
    """What `workers` threads in a few processes take in so many seconds."""
    processes = min(PROCESSES, workers)
    shares = [workers // processes + (number < workers % processes) for number in range(processes)]
    context = get_context("spawn")
    with ProcessPoolExecutor(processes, context, _meet_at, (context.Barrier(processes),)) as pool:
        jobs = [pool.submit(_share, url, share, seconds) for share in shares]
        done = [job.result() for job in jobs]
    ids = [job_id for share in done for job_id in share[0]]
    claims = _spread([value for _, lasted, _ in done for value in lasted])
    ends = _spread([value for _, _, lasted in done for value in lasted])
    return Taken(workers, len(ids) / seconds, claims, ends, len(ids) - len(set(ids)))


_MEETING: list[ProcessBarrier] = []


def _meet_at(barrier: ProcessBarrier) -> None:
    _MEETING.append(barrier)


def _meet() -> None:
    _MEETING[0].wait()


def _share(url: str, threads: int, seconds: float) -> tuple[list[str], list[float], list[float]]:
    """The ids that `threads` threads took, and how long their claims and endings lasted, once all are connected."""
    settings = Settings(database=DatabaseSettings(url, pool_size=threads))
    database, together = Database(settings), Barrier(threads, action=_meet)
    ids, claims, ends = list[str](), list[float](), list[float]()

    def work() -> None:
        with database.reading() as session:
            session.connection()
            together.wait()
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s and (one := _one_job(database)):
            ids.append(one[0])
            claims.append(one[1])
            ends.append(one[2])

    workers = [Thread(target=work) for _ in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    database.close()
    return ids, claims, ends


def _one_job(database: Database) -> tuple[str, float, float] | None:
    begin_s = time.perf_counter()
    with database.transaction() as session:
        taken = claim(session, "ingest")
    claimed_s = time.perf_counter()
    if taken is None:
        return None
    with database.transaction() as session:
        succeed(session, taken, Outcome(), 3)
    return taken.job_id, claimed_s - begin_s, time.perf_counter() - claimed_s


def _spread(values_s: Sequence[float]) -> tuple[float, float, float]:
    if not values_s:
        return 0.0, 0.0, 0.0
    p50, p95, longest = np.percentile(values_s, (50, 95, 100)) * 1e3
    return float(p50), float(p95), float(longest)


def _show(found: Sequence[Taken], backlog: int) -> int:
    """Print; 1 when a job was taken twice."""
    table = Table(
        "workers", "jobs a second", title=f"{backlog:,} jobs ready, {OWNERS} owners; ms are p50, p95, longest"
    )
    for column in ("claim ms", "", " ", "end ms", "  ", "   ", "doubled"):
        table.add_column(column, justify="right")
    for one in found:
        figures = (f"{value:.1f}" for value in (one.jobs_per_s, *one.claims_ms, *one.ends_ms))
        table.add_row(str(one.workers), *figures, str(one.doubled))
    Console(width=140).print(table)
    return 1 if any(one.doubled for one in found) else 0


if __name__ == "__main__":
    main()
