"""Every list, board, claim and maintenance query on a database with a million sequences: `python -m benchmarks.rows`.

PostgreSQL is filled with synthetic rows (`--sequences`, `--submissions`, `--artefacts` per sequence); then each query
runs through its route or function, `--repeats` times with other parameters. The table shows the database's time (p50,
p95, all statements of a query together), the rows read, and full scans of large tables. Sizes of tables and depths of
indexes allow extrapolation to more rows. The exit code is 1 if a query misses an index.
"""

import argparse
import json
import logging
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import numpy as np
import structlog
from rich.console import Console
from rich.table import Table
from sqlalchemy import Connection, Engine

from benchmarks.rows.bulk_inserts import analyse, prepare
from benchmarks.rows.kinds import Amounts, fill
from benchmarks.rows.plans import StatementPlan, explained, large_tables, record_statements
from benchmarks.rows.queries import Kit, Question, people_of, questions
from services.runtime.database.migrate import upgrade
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import ApiSettings, DatabaseSettings, Settings
from testing.api.serving import client_of
from testing.servers.postgres import running_postgres

MEMORY = {
    "shared_buffers": "1GB",
    "maintenance_work_mem": "512MB",
    "work_mem": "64MB",
    "max_wal_size": "1GB",
    "synchronous_commit": "off",
    "max_parallel_workers_per_gather": "0",
    "jit": "off",
}
PATIENCE_S, ENOUGH_S = 120.0, 30.0


@dataclass(frozen=True)
class QuestionTimes:
    """One query: times in ms, rows read by its costliest statement, and full scans."""

    name: str
    statements: int
    p50_ms: float
    p95_ms: float
    rows_read: int
    faults: tuple[str, ...]
    bound: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequences", type=int, default=1_000_000)
    parser.add_argument("--submissions", type=int, default=100_000)
    parser.add_argument("--artefacts", type=int, default=4, help="per sequence, each with a blob of its own")
    parser.add_argument("--frames", type=int, default=4, help="rows of labelled frames per sequence")
    parser.add_argument("--backlog", type=int, default=20_000, help="runs that wait")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--json", type=Path, default=Path("build") / "rows.json")
    options = parser.parse_args()
    amounts = Amounts(
        options.sequences,
        options.submissions,
        artefacts_each=options.artefacts,
        frames_each=options.frames,
        backlog=min(options.backlog, options.sequences // 4),
        members=min(100_000, options.sequences // 10),
    )
    with TemporaryDirectory() as folder, running_postgres(**MEMORY) as server:
        api = ApiSettings(requests_per_minute=10**9)
        platform = open_platform(Settings(data_folder=Path(folder), database=DatabaseSettings(server.url()), api=api))
        begin_s = time.monotonic()
        _fill(platform, amounts)
        Console(stderr=True).print(f"filled in {time.monotonic() - begin_s:.0f} s")
        answers = _answers(platform, amounts, options.repeats)
        sizes = sizes_of(platform.database.engine)
        platform.database.close()
    record = {"amounts": asdict(amounts), "answers": [asdict(answer) for answer in answers], "sizes": sizes}
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    sys.exit(_show(answers, sizes))


def _fill(platform: Platform, amounts: Amounts) -> None:
    upgrade(platform.settings)
    with platform.database.engine.connect() as connection:
        connection = connection.execution_options(isolation_level="AUTOCOMMIT")
        prepare(connection)
        fill(connection, amounts)
        analyse(connection)


def _quietly() -> None:
    """Disable the log line of every request."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))


def _answers(platform: Platform, amounts: Amounts, repeats: int) -> list[QuestionTimes]:
    _quietly()
    people = people_of(platform)
    with client_of(platform) as client, platform.database.engine.connect() as connection:
        client.timeout = PATIENCE_S
        kit = Kit(platform, client, people, amounts)
        large = large_tables(connection)
        answers = []
        for question in questions():
            answers.append(answered(kit, question, (connection, large), repeats))
            Console(stderr=True).print(f"{answers[-1].p95_ms:9.1f} ms  {question.name}  {' '.join(answers[-1].faults)}")
        return answers


def answered(kit: Kit, question: Question, at: tuple[Connection, frozenset[str]], repeats: int) -> QuestionTimes:
    """Run the query `repeats` times, and explain its statements once."""
    connection, large = at
    lasted_s, plans, until_s = [], dict[str, StatementPlan](), time.monotonic() + ENOUGH_S
    for number in range(repeats):
        with record_statements(kit.platform.database.engine) as statements:
            is_answered = _is_answered(kit, question, Random(number))
        lasted_s.append(sum(item.lasted_s for item in statements) if is_answered else PATIENCE_S)
        for statement in statements:
            if statement.is_explained and statement.sql not in plans:
                plans[statement.sql] = explained(connection, statement, large)
                connection.rollback()
        if sum(lasted_s) > ENOUGH_S or time.monotonic() > until_s:
            break
    faults = tuple(dict.fromkeys(fault for plan in plans.values() for fault in plan.faults))
    rows_read = max((plan.rows_read or 0 for plan in plans.values()), default=0)
    p50, p95 = (float(np.percentile(lasted_s, share)) * 1e3 for share in (50, 95))
    return QuestionTimes(question.name, len(statements), p50, p95, rows_read, faults, question.bound)


def _is_answered(kit: Kit, question: Question, chance: Random) -> bool:
    """Return whether the query was answered within an acceptable time."""
    try:
        question.ask(kit, chance)
    except httpx.TimeoutException:
        return False
    return True


def sizes_of(engine: Engine) -> list[dict[str, Any]]:
    """Return for every table with rows their number, and the bytes of the table and of its indexes."""
    query = """SELECT relname, reltuples::bigint AS rows, pg_relation_size(oid) AS table_bytes,
        pg_indexes_size(oid) AS index_bytes FROM pg_class
        WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace AND reltuples >= 10000 ORDER BY reltuples DESC"""
    with engine.connect() as connection:
        return [dict(row) for row in connection.exec_driver_sql(query).mappings()]


def _show(answers: list[QuestionTimes], sizes: list[dict[str, Any]]) -> int:
    """Print the results; return 1 after an unnecessary full scan of a large table."""
    console, table = Console(width=150), Table("question", "statements", "p50 ms", "p95 ms", "rows read", "read whole")
    for answer in answers:
        faults = "; ".join(answer.faults) + (f" ({answer.bound})" if answer.bound else "")
        table.add_row(
            answer.name,
            str(answer.statements),
            f"{answer.p50_ms:.2f}",
            f"{answer.p95_ms:.2f}",
            str(answer.rows_read),
            faults,
        )
    console.print(table)
    held = Table("table", "rows", "table MB", "indexes MB", "bytes a row")
    for row in sizes:
        both = row["table_bytes"] + row["index_bytes"]
        megabytes = (f"{row[key] / 1e6:.0f}" for key in ("table_bytes", "index_bytes"))
        held.add_row(row["relname"], f"{row['rows']:,}", *megabytes, f"{both / row['rows']:.0f}")
    console.print(held)
    missed = [answer.name for answer in answers if answer.faults and not answer.bound]
    console.print(f"without an index: {missed or 'none'}")
    return 1 if missed else 0


if __name__ == "__main__":
    main()
