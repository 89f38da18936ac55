"""The schema: what the revisions make is what the rows say, on both databases, however many start at once."""

import multiprocessing
from collections.abc import Iterator
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text
from sqlalchemy.schema import CreateIndex

from services.runtime.database.migrate import (
    MIGRATIONS,
    alembic_on,
    head_revision,
    is_known,
    schema_connection,
    upgrade,
)
from services.runtime.database.transactions import Database
from services.runtime.errors import BrokenReferenceError, NewerSchemaError
from services.runtime.orm import Base, Job
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer

ORDERED = "ix_jobs_ready"
"""An index with a column in descending order, which SQLite does not tell when it is asked for its indexes."""


@pytest.fixture(params=["sqlite", "postgres"])
def empty(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Settings]:
    """Settings of a database without any table."""
    if request.param == "sqlite":
        yield make_settings(tmp_path)
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        yield make_settings(tmp_path, database=DatabaseSettings(url))


def test_a_database_of_a_newer_version_is_refused(platform_on: Platform) -> None:
    with platform_on.database.transaction() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(NewerSchemaError, match="revision '9999'"):
        upgrade(platform_on.settings)


def test_a_change_that_leaves_a_row_without_its_parent_is_undone(platform: Platform) -> None:
    with pytest.raises(BrokenReferenceError, match="'tokens' refers to a row of 'users'"):  # noqa: SIM117
        with schema_connection(platform.settings) as connection:
            connection.execute(
                text("INSERT INTO tokens VALUES ('t', 'nobody', 'n', 'h', '[]', 1, 2, NULL, NULL)"),
            )
    with platform.database.reading() as session:
        assert session.scalar(text("SELECT count(*) FROM tokens")) == 0


def test_the_revisions_make_exactly_the_tables_of_the_rows(platform_on: Platform) -> None:
    with platform_on.database.engine.connect() as connection:
        hidden = {ORDERED} if connection.dialect.name == "sqlite" else set()
        include = {"include_object": lambda _object, name, *_: name not in hidden}
        context = MigrationContext.configure(connection, opts={"compare_server_default": True, **include})
        assert compare_metadata(context, Base.metadata) == []


def test_the_index_whose_order_sqlite_does_not_tell_is_made_as_the_rows_say(platform: Platform) -> None:
    (index,) = (one for one in Base.metadata.tables[Job.__tablename__].indexes if one.name == ORDERED)
    with platform.database.engine.connect() as connection:
        made = connection.scalar(text(f"SELECT sql FROM sqlite_master WHERE name = '{ORDERED}'"))
        assert made.split() == str(CreateIndex(index).compile(connection)).split()


def test_an_upgrade_of_an_upgraded_database_changes_nothing(platform_on: Platform) -> None:
    with platform_on.database.transaction() as session:
        session.execute(text("INSERT INTO queues VALUES ('ingest', 'paused')"))
    upgrade(platform_on.settings)
    with platform_on.database.reading() as session:
        assert session.execute(text("SELECT name, mode FROM queues")).all() == [("ingest", "paused")]


def test_processes_that_upgrade_at_once_all_succeed(empty: Settings) -> None:
    """Catches alone two processes that change the schema at once."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=upgrade, args=(empty,)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(300)
    assert [process.exitcode for process in processes] == [0, 0]
    assert tables_of(empty) == {*Base.metadata.tables, "alembic_version"}


def test_downgrading_to_the_base_leaves_no_table(empty: Settings) -> None:
    upgrade(empty)
    with schema_connection(empty) as connection:
        command.downgrade(alembic_on(connection), "base")
    assert tables_of(empty) == {"alembic_version"}


def tables_of(settings: Settings) -> set[str]:
    database = Database(settings)
    names = set(inspect(database.engine).get_table_names())
    database.close()
    return names


def test_the_command_that_writes_a_revision_knows_all_and_writes_into_the_last_folder() -> None:
    """Its file lists the folders; this code walks them."""
    revisions = ScriptDirectory.from_config(Config(MIGRATIONS / "alembic.ini"))
    assert revisions.get_current_head() == head_revision()
    assert all(is_known(each.revision) for each in revisions.walk_revisions())
    files = sorted(MIGRATIONS.glob("versions/*/r*.py"))
    assert len(list(revisions.walk_revisions())) == len(files)
    assert revisions.get_revision(head_revision()).path == str(files[-1])
