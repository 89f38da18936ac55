"""A database of a previous release, every table filled and jobs running, serves this one: no row is lost."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Connection,
    Float,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    select,
    text,
)
from sqlalchemy.exc import DBAPIError

from services.runtime.database.migrate import alembic_on, schema_connection, upgrade
from services.runtime.database.migrations.versions.r0001_r0020.r0019_words import COLUMNS, METRICS, TABLES
from services.runtime.database.migrations.versions.r0021_r0040 import r0022_spectra
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.fixtures import make_settings, opened
from testing.servers.postgres import PostgresServer
from tests.services.runtime.jobs.steps import job, run_all, succeed

PREVIOUS = "0018"
OLDER = "0012"
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
    "tallies": ({"counts": {next(iter(METRICS)): {"ingest": 2.0}, "stone_frames": {"scored": 1.0}}}, {}, {}),
}


@pytest.fixture(
    params=[
        pytest.param(("sqlite", PREVIOUS), id="sqlite"),
        pytest.param(("sqlite", OLDER), id="older", marks=pytest.mark.whole),
        pytest.param(("postgres", PREVIOUS), id="postgres", marks=pytest.mark.whole),
    ]
)
def previous(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Settings, Rows]]:
    """Settings of a database that a previous release made, and the rows in it."""
    database, revision = request.param
    if database == "sqlite":
        settings = make_settings(tmp_path)
        yield settings, filled(settings, revision)
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        settings = make_settings(tmp_path, database=DatabaseSettings(url))
        yield settings, filled(settings, revision)


def filled(settings: Settings, revision: str = PREVIOUS) -> Rows:
    """Every table of a previous release with some rows, each of which refers to others."""
    with schema_connection(settings) as connection:
        command.upgrade(alembic_on(connection), revision)
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


def renamed(rows: Rows) -> Rows:
    """The rows of a previous release by the names of this one, of tables, columns and counted metrics."""
    return {
        TABLES.get(table, table): [
            {_renamed_column(table, name): _renamed_counts(name, value) for name, value in row.items()}
            for row in of_table
        ]
        for table, of_table in rows.items()
    }


def _renamed_column(table: str, column: str) -> str:
    since_0019 = COLUMNS.get(table, {}).get(column, column)
    return r0022_spectra.NEW if (table, since_0019) == ("scores", r0022_spectra.OLD) else since_0019


def _renamed_counts(column: str, value: Any) -> Any:
    is_counted = column == "counts" and isinstance(value, dict)
    return {METRICS.get(name, name): of_metric for name, of_metric in value.items()} if is_counted else value


def rows_in(connection: Connection, table: Table, names: Collection[str]) -> list[dict[str, Any]]:
    """The named columns of a table's rows, in some order that is always the same."""
    kept = [column for column in table.columns if column.name in names]
    assert len(kept) == len(names), f"columns of {table.name} are gone"
    return in_order(dict(row) for row in connection.execute(select(*kept)).mappings())


def in_order(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(({name: row[name] for name in sorted(row)} for row in rows), key=repr)


def test_every_value_of_every_table_is_where_it_was(previous: tuple[Settings, Rows]) -> None:
    settings, before = previous[0], renamed(previous[1])
    assert len(before) > 40, "the release had more tables than that"
    upgrade(settings)
    with schema_connection(settings) as connection:
        tables = tables_of(connection)
        assert before.keys() <= tables.keys()
        for name, rows in before.items():
            assert rows_in(connection, tables[name], rows[0]) == in_order(rows)


def test_going_back_brings_back_every_value_under_its_old_name(previous: tuple[Settings, Rows]) -> None:
    settings, before = previous
    upgrade(settings)
    with schema_connection(settings) as connection:
        command.downgrade(alembic_on(connection), PREVIOUS if "tallies" in before else OLDER)
    with schema_connection(settings) as connection:
        tables = tables_of(connection)
        for name, rows in before.items():
            assert rows_in(connection, tables[name], rows[0]) == in_order(rows)


def test_what_refuses_changes_refuses_them_still(previous: tuple[Settings, Rows]) -> None:
    settings, before = previous
    if "tallies" not in before:
        with schema_connection(settings) as connection:
            command.upgrade(alembic_on(connection), PREVIOUS)
    with schema_connection(settings) as connection:
        triggers = triggers_of(connection)
        assert {table for _, table, _ in triggers} >= {"audit_log", "audit_anchors", "scores", "scoring_ledger"}
    upgrade(settings)
    with schema_connection(settings) as connection:
        assert triggers_of(connection) >= triggers
    refused = pytest.raises(DBAPIError, match="only added to")
    with schema_connection(settings) as connection, refused, connection.begin_nested():
        connection.execute(text("UPDATE scores SET miou = 0.5"))


def triggers_of(connection: Connection) -> set[tuple[str, str, str]]:
    """Name, table and definition."""
    asked = {
        "sqlite": "SELECT name, tbl_name, sql FROM sqlite_master WHERE type = 'trigger'",
        "postgresql": "SELECT tgname, relname, pg_get_triggerdef(pg_trigger.oid) FROM pg_trigger "
        "JOIN pg_class ON pg_class.oid = tgrelid WHERE NOT tgisinternal",
    }
    return {(name, table, made) for name, table, made in connection.execute(text(asked[connection.dialect.name]))}


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
