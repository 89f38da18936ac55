"""The next revision, as Alembic's command writes it, keeps every row, also if SQLite copies a table for it."""

import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from alembic.config import Config
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
    update,
)
from sqlalchemy.exc import DBAPIError

from services.runtime.database import migrate
from services.runtime.database.migrate import current_revision, head_revision, schema_connection, upgrade
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer

ROWS = 3
NEXT = "0041"
CHANGE = """with op.batch_alter_table("sequences") as sequences:
        sequences.alter_column("name", type_=sa.String(length=120))
"""
FROZEN = (
    *("activations", "audit_anchors", "audit_log", "datasets", "dataset_inputs", "dataset_input_packs"),
    *("dataset_members", "dataset_packs", "dataset_parts", "scores", "scoring_ledger"),
)
REFUSAL = r"only added to|append-only|does not change"
Rows = Mapping[str, list[dict[str, Any]]]


def add_revision(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Give this code one more revision, which changes the type of a column of a table that others refer to."""
    folder = Path(shutil.copytree(migrate.MIGRATIONS, tmp_path / "migrations"))
    command.revision(Config(folder / "alembic.ini"), "Longer names", rev_id=NEXT)
    path = folder / "versions" / f"r{NEXT}_longer_names.py"
    path.write_text(path.read_text().replace("pass", CHANGE, 1))
    monkeypatch.setattr(migrate, "MIGRATIONS", folder)


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.whole)])
def previous(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Settings, Rows]]:
    """Settings of a database of the baseline, and the rows in it."""
    if request.param == "sqlite":
        settings = make_settings(tmp_path)
        yield settings, filled(settings)
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        settings = make_settings(tmp_path, database=DatabaseSettings(url))
        yield settings, filled(settings)


def filled(settings: Settings) -> Rows:
    """Every table with some rows, each of which refers to others."""
    upgrade(settings)
    with schema_connection(settings) as connection:
        laid: dict[str, list[dict[str, Any]]] = {}
        for table in tables_of(connection).values():
            laid[table.name] = [
                {column.name: value_of(column, number, laid) for column in table.columns} for number in range(ROWS)
            ]
            connection.execute(table.insert(), laid[table.name])
    return laid


def tables_of(connection: Connection) -> dict[str, Table]:
    metadata = MetaData()
    metadata.reflect(connection)
    return {table.name: table for table in metadata.sorted_tables if table.name != "alembic_version"}


def value_of(column: Column[Any], number: int, laid: Rows) -> Any:
    """A value of the column's type, another in each row; of a column that refers to a table, that of its row."""
    for key in column.foreign_keys:
        if key.column.table is column.table:
            return value_of(key.column, number, laid)
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


def rows_in(connection: Connection, table: Table, names: Collection[str]) -> list[dict[str, Any]]:
    """The named columns of a table's rows, in some order that is always the same."""
    kept = [column for column in table.columns if column.name in names]
    assert len(kept) == len(names), f"columns of {table.name} are gone"
    return in_order(dict(row) for row in connection.execute(select(*kept)).mappings())


def in_order(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(({name: row[name] for name in sorted(row)} for row in rows), key=repr)


def test_every_value_of_every_table_is_where_it_was(
    previous: tuple[Settings, Rows], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    settings, before = previous
    add_revision(monkeypatch, tmp_path)
    assert head_revision() == NEXT
    upgrade(settings)
    with schema_connection(settings) as connection:
        assert current_revision(connection) == NEXT
        tables = tables_of(connection)
        assert before.keys() == tables.keys()
        assert getattr(tables["sequences"].columns["name"].type, "length", 0) == 120
        for name, rows in before.items():
            assert rows_in(connection, tables[name], rows[0]) == in_order(rows)


def test_what_never_changes_is_refused_by_the_database(previous: tuple[Settings, Rows]) -> None:
    with schema_connection(previous[0]) as connection:
        tables = tables_of(connection)
        for name in FROZEN:
            first = next(iter(tables[name].columns))
            with pytest.raises(DBAPIError, match=REFUSAL), connection.begin_nested():
                connection.execute(update(tables[name]).values({first.name: first}))
