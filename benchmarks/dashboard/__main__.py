"""Speed of the administrator's pages: `python -m benchmarks.dashboard [--runs 10000] [--workers 50] [--plans]`.

The platform has 10,000 runs of five jobs each (60,000 rows) and 50 worker processes. One reader requests the site's
pages from a socket of this process one after another, so latencies are the server's own. CPU is this process's, which
is more reliable on a busy machine. `--plans` prints the database's query plan of each statement of the list: full
scans, and the used indexes.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from rich.console import Console
from rich.table import Table
from sqlalchemy import event, text

from api.middleware.context import COOKIE
from benchmarks.api import database_url
from benchmarks.dashboard.rows import fill
from services.runtime.access import sessions
from services.runtime.database.migrate import upgrade
from services.runtime.orm import User
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import ApiSettings, DatabaseSettings, Settings
from testing.api.serving import person, serving
from web.main import make_site

PAGES = (
    "/admin/jobs",
    "/admin/jobs?list=failed",
    "/admin/jobs?list=dead",
    "/admin/jobs?list=succeeded&owner=ada",
    "/admin/jobs?queue=labeler&kind=labeler.surface",
    "/admin/jobs?id_part=0f1e",
    "/admin/jobs/{running}",
    "/admin/queues",
    "/api/v1/admin/jobs",
    "/api/v1/admin/jobs/counts",
)
COLUMNS = ("database", "page", "bytes", "p50 ms", "p95 ms", "least ms", "CPU ms")
EXPLAINED = {"sqlite": "EXPLAIN QUERY PLAN ", "postgresql": "EXPLAIN "}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=50)
    parser.add_argument("--requests", type=int, default=40, help="per page")
    parser.add_argument("--plans", action="store_true")
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgres"], choices=["sqlite", "postgres"])
    options = parser.parse_args()
    table = Table(*COLUMNS, title=f"{options.runs:,} runs of 5 jobs, {options.workers} workers")
    console = Console(width=140)
    for kind in options.databases:
        with tempfile.TemporaryDirectory() as folder, database_url(kind) as url:
            settings = Settings(
                data_folder=Path(folder),
                database=DatabaseSettings(url),
                api=ApiSettings(requests_per_minute=10**6),
            )
            for row in measured(settings, options, console):
                table.add_row(kind, *row)
    console.print(table)


def measured(settings: Settings, options: argparse.Namespace, console: Console) -> Iterator[tuple[str, ...]]:
    upgrade(settings)
    platform = open_platform(settings)
    with platform.database.transaction() as session:
        running = fill(session, options.runs, options.workers).running_id
    if not platform.database.is_sqlite:
        with platform.database.transaction() as session:
            session.execute(text("ANALYZE"))
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        client.headers.update({"Cookie": f"{COOKIE}={_secret(platform)}"})
        for template in PAGES:
            yield template, *_timed(client, template.format(running=running), options.requests)
        if options.plans:
            for line in plans(platform, client, PAGES[0]):
                console.print(line, highlight=False)
    platform.database.close()


def _timed(client: httpx.Client, path: str, requests: int) -> tuple[str, ...]:
    waited_ms, size, begun_cpu_s = list[float](), 0, 0.0
    for number in range(requests + 2):
        begun_cpu_s = time.process_time() if number == 2 else begun_cpu_s
        begin_s = time.perf_counter()
        answer = client.get(path)
        waited_ms.append((time.perf_counter() - begin_s) * 1000)
        answer.raise_for_status()
        size = len(answer.content)
    cpu_ms = 1000 * (time.process_time() - begun_cpu_s) / requests
    p50, p95 = np.percentile(waited_ms[2:], [50, 95])
    return f"{size:,}", f"{p50:.0f}", f"{p95:.0f}", f"{min(waited_ms[2:]):.0f}", f"{cpu_ms:.0f}"


def plans(platform: Platform, client: httpx.Client, path: str) -> Iterator[str]:
    """Yield each statement of the page, shortened, and the steps of its query plan."""
    with _statements(platform) as statements:
        client.get(path).raise_for_status()
    dialect = platform.database.engine.dialect.name
    with platform.database.engine.connect() as connection:
        for statement, parameters in statements:
            if not statement.lstrip().startswith("SELECT"):
                continue
            yield f"\n{' '.join(statement.split())[:200]}"
            for row in connection.exec_driver_sql(EXPLAINED[dialect] + statement, parameters):
                yield f"    {row[-1]}"


@contextmanager
def _statements(platform: Platform) -> Iterator[list[tuple[str, Any]]]:
    statements = list[tuple[str, Any]]()

    def note(_connection: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        statements.append((statement, parameters))

    event.listen(platform.database.engine, "before_cursor_execute", note)
    yield statements
    event.remove(platform.database.engine, "before_cursor_execute", note)


def _secret(platform: Platform) -> str:
    administrator = person(platform, "administrator")
    with platform.database.transaction() as session:
        return sessions.open_session(session, session.get_one(User, administrator.user_id), 3600.0).secret


if __name__ == "__main__":
    main()
