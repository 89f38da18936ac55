"""What an answer of `/metrics` costs with a million jobs: `python -m benchmarks.metrics`.

PostgreSQL is filled with `--jobs` jobs (one of ten ready, two waiting, the rest ended), `--workers` worker processes
and as many rows of counts, beside those of eight API processes; then the API's own meters are asked `--repeats` times.
Given are the time of an answer, of the questions about jobs, queues and workers alone, the answer's size, and what
reads a large table whole (nothing should; it ends with 1 then).
"""

import argparse
import json
import logging
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import structlog
from sqlalchemy import text

from api.metrics import Meters
from benchmarks.rows.plans import explained, large_tables, taken_down
from services.runtime.database_clock import database_ns
from services.runtime.migrate import upgrade
from services.runtime.orm import Tally, User, Worker, new_id
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import BrokerSettings, DatabaseSettings, Settings
from services.runtime.telemetry.meters import JOB_SECONDS, REQUEST_SECONDS, REQUESTS
from services.runtime.telemetry.standing import standing
from services.runtime.telemetry.tallies import Counts, Tallies
from tests.servers.postgres import running_postgres

KINDS = ("ingest.register", "labeler.map", "labeler.tile", "labeler.frames", "eval.open", "eval.part", "eval.join")
ROUTES = 120
API_PROCESSES = 8
JOBS = """
INSERT INTO jobs (id, root_id, owner_id, kind, queue, state, priority, arguments, needs_left, attempt, attempts_left,
    heartbeats, cancel_reason, stage, done, total, failure_code, failure, revision, created_ns, ready_ns)
SELECT lpad(to_hex(number), 32, '0'), lpad(to_hex(number), 32, '0'), :owner, 'labeler.frames',
    (ARRAY['ingest', 'labeler', 'eval'])[1 + number % 3],
    CASE WHEN number % 10 < 3 THEN 'queued' ELSE 'succeeded' END, 0, '{}',
    CASE WHEN number % 10 = 0 THEN 0 ELSE 1 END, 0, 3, 0, '', '', 0, 0, '', '', 1, number, number
FROM generate_series(1, :jobs) AS number
"""


def fill(platform: Platform, jobs: int, workers: int) -> None:
    """The rows, and what PostgreSQL should know of them."""
    of_workers, of_apis = _counted()
    with platform.database.transaction() as session:
        owner = User(name="ada", role="curator")
        session.add(owner)
        session.flush()
        session.execute(text(JOBS), {"owner": owner.id, "jobs": jobs})
        for number in range(workers):
            named = {"name": f"worker-{number}:1", "queues": "ingest,labeler,eval", "started_ns": 1}
            session.add(Worker(**named, beats=1, beat_ns=database_ns(), held_bytes=10**9, disk_free_bytes=10**12))
            session.add(Tally(id=new_id(), counts=of_workers, told_ns=database_ns()))
        session.add_all(Tally(id=new_id(), counts=of_apis, told_ns=database_ns()) for _ in range(API_PROCESSES))
    with platform.database.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("VACUUM ANALYZE"))


def _counted() -> tuple[Counts, Counts]:
    """What a worker process has counted, and what an API process."""
    of_workers, of_apis = Tallies(), Tallies()
    for kind in KINDS:
        for seconds in JOB_SECONDS.bounds:
            of_workers.observe(JOB_SECONDS, (kind, "succeeded"), seconds)
    for route in range(ROUTES):
        of_apis.observe(REQUEST_SECONDS, ("GET", f"/api/v1/route-{route}"), 0.01)
        of_apis.add(REQUESTS, ("GET", f"/api/v1/route-{route}", "200"))
    return of_workers.counts(), of_apis.counts()


def asked(platform: Platform, repeats: int) -> dict[str, Any]:
    """Seconds of whole answers and of the statements of each, and the answer's size."""
    meters, answers_s, statements_s, size_bytes = Meters(platform), [], [], 0
    for _ in range(repeats):
        begun_s = time.perf_counter()
        size_bytes = len(meters.exposition())
        answers_s.append(time.perf_counter() - begun_s)
        begun_s = time.perf_counter()
        with platform.database.reading() as session:
            standing(session, 4.0)
        statements_s.append(time.perf_counter() - begun_s)
    figures = {"answer": answers_s, "standing": statements_s}
    of_all = {
        f"{name}_p{q}_ms": round(float(np.percentile(all_s, q)) * 1e3, 1)
        for name, all_s in figures.items()
        for q in (50, 95)
    }
    return {**of_all, "answer_bytes": size_bytes}


def faults(platform: Platform) -> list[str]:
    """What the statements of a standing read whole."""
    engine = platform.database.engine
    with taken_down(engine) as statements, platform.database.reading() as session:
        standing(session, 4.0)
    with engine.connect() as connection:
        large = large_tables(connection)
        plans = [explained(connection, one, large) for one in statements if one.is_explained]
    return [fault for plan in plans for fault in plan.faults]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=30)
    chosen = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))  # the broker is away
    with TemporaryDirectory() as folder, running_postgres() as server, server.fresh_database() as url:
        broker = BrokerSettings("redis://127.0.0.1:1/0")  # its bells are not what is measured
        settings = Settings(data_folder=Path(folder), database=DatabaseSettings(url), broker=broker)
        upgrade(settings)
        platform = open_platform(settings)
        fill(platform, chosen.jobs, chosen.workers)
        found = {"jobs": chosen.jobs, "workers": chosen.workers, **asked(platform, chosen.repeats)}
        found["faults"] = faults(platform)
        platform.database.close()
    print(json.dumps(found, indent=1))
    return 1 if found["faults"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
