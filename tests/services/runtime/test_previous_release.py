"""A database of the previous release, every table filled and jobs running, serves this one: no row is lost."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from sqlalchemy import JSON, Boolean, Column, Connection, Float, Integer, LargeBinary, MetaData, Table, select

from services.runtime.jobs.sweeping import Sweeper
from services.runtime.migrate import alembic_on, schema_connection, upgrade
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, Settings
from tests.servers.fixtures import make_settings, opened
from tests.servers.postgres import PostgresServer
from tests.services.runtime.jobs.steps import job, run_all, succeed

PREVIOUS = "0012"
ROWS = 3
RUN, RUNNING, WAITING = range(ROWS)
Rows = Mapping[str, list[dict[str, Any]]]
# What the rows of a run under way look like; of everything else any row will do.
WELL = {"cancel_reason": "", "failure_code": "", "failure": ""}
PARTICULAR: dict[str, tuple[dict[str, Any], ...]] = {
    "jobs": (
        {**WELL, "queue": "", "kind": "sequence.process", "state": "running", "needs_left": 0},
        {**WELL, "queue": "ingest", "kind": "ingest.ok", "state": "running", "needs_left": 0, "attempt": 1},
        {**WELL, "queue": "labeler", "kind": "labeler.ok", "state": "queued", "needs_left": 1, "attempt": 0},
    ),
    "job_attempts": ({"number": 9}, {"number": 1, "outcome": ""}, {"number": 9}),
    "queues": ({"mode": "open"},) * ROWS,
}


@pytest.fixture(params=["sqlite", "postgres"])
def previous(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Settings, Rows]]:
    """Settings of a database that the previous release made, and the rows in it."""
    if request.param == "sqlite":
        settings = make_settings(tmp_path)
        yield settings, filled(settings)
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        settings = make_settings(tmp_path, database=DatabaseSettings(url))
        yield settings, filled(settings)


def filled(settings: Settings) -> Rows:
    """Every table of the previous release with some rows, each of which refers to others."""
    with schema_connection(settings) as connection:
        command.upgrade(alembic_on(connection), PREVIOUS)
        laid: dict[str, list[dict[str, Any]]] = {}
        for table in tables_of(connection).values():
            laid[table.name] = [row_of(table, number, laid) for number in range(ROWS)]
            connection.execute(table.insert(), laid[table.name])
    return laid


def tables_of(connection: Connection) -> dict[str, Table]:
    metadata = MetaData()
    metadata.reflect(connection)
    return {table.name: table for table in metadata.sorted_tables if table.name != "alembic_version"}


def row_of(table: Table, number: int, laid: Rows) -> dict[str, Any]:
    row = {column.name: value_of(column, number, laid) for column in table.columns}
    if table.name == "jobs":
        row["root_id"] = laid_id(table, RUN)
    if table.name == "job_needs":  # the one that waits needs the one that runs; the others nothing that matters
        ids = [laid["jobs"][other]["id"] for other in (WAITING, RUNNING, RUN)]
        row = {"job_id": ids[number], "needed_id": ids[min(number + 1, RUN + 2)]}
    return row | dict(PARTICULAR.get(table.name, ({},) * ROWS)[number])


def laid_id(table: Table, number: int) -> str:
    return str(value_of(table.columns["id"], number, {}))


def value_of(column: Column[Any], number: int, laid: Rows) -> Any:
    """A value of the column's type, another in each row; where the column refers to a table, that of its row."""
    for key in column.foreign_keys:
        if key.column.table is not column.table:
            return laid[key.column.table.name][number][key.column.name]
    if isinstance(column.type, Boolean):
        return True
    if isinstance(column.type, JSON):
        return {"é": [number, 0.5, None]}
    if isinstance(column.type, LargeBinary):
        return bytes([number, 255])
    if isinstance(column.type, Float):
        return 0.25 + number / 8
    if isinstance(column.type, Integer):
        return number + 1
    return f"{number}{column.table.name}{column.name}"[: getattr(column.type, "length", None) or 8]


def test_every_value_of_every_table_is_where_it_was(previous: tuple[Settings, Rows]) -> None:
    settings, before = previous
    assert len(before) > 40, "the release had more tables than that"
    upgrade(settings)
    with schema_connection(settings) as connection:
        tables = tables_of(connection)
        assert before.keys() <= tables.keys()
        for name, rows in before.items():
            kept = [column for column in tables[name].columns if column.name in rows[0]]
            assert len(kept) == len(rows[0]), f"columns of {name} are gone"
            found = [dict(row) for row in connection.execute(select(*kept)).mappings()]
            assert sorted(found, key=repr) == sorted(
                ({column.name: row[column.name] for column in kept} for row in rows), key=repr
            )


def test_jobs_that_ran_and_waited_then_are_done_now(previous: tuple[Settings, Rows]) -> None:
    settings, before = previous
    upgrade(settings)
    platform = opened(settings, [])
    try:
        run, running, waiting = (row["id"] for row in before["jobs"])
        forget_workers(platform)
        assert [job(platform, id_).state for id_ in (run, running, waiting)] == ["running", "queued", "queued"]
        run_all(platform, {"ingest.ok": succeed, "labeler.ok": succeed})
        assert [job(platform, id_).state for id_ in (run, running, waiting)] == ["succeeded"] * ROWS
    finally:
        platform.database.close()


def forget_workers(platform: Platform) -> None:
    """The workers of the previous release are gone: a lease passes without a sign of them."""
    now_s = [0.0]
    sweeper = Sweeper(platform, lambda queue: 0, lambda queue, times: None, lambda: now_s[0])
    sweeper.recover()
    now_s[0] = platform.settings.jobs.lease_s
    assert sweeper.recover() == 1
