"""The schema: what the revisions make is what the rows say, on both databases, however many start at once."""

import multiprocessing

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect, text

from services.runtime.database.migrate import alembic_on, schema_connection, upgrade
from services.runtime.database.transactions import Database
from services.runtime.orm import Base
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from testing.refusals import refused_as
from tests.services.domain.benchmarks.scored import phase_of_rows

ORDERED = "ix_jobs_ready"
"""An index with a column in descending order, which SQLite does not tell when it is asked for its indexes."""


@pytest.mark.parametrize(("revision", "code"), [("9999", "schema_newer"), ("0029", "schema_older")])
def test_a_database_of_a_revision_that_this_code_lacks_is_refused(platform: Platform, revision: str, code: str) -> None:
    with platform.database.transaction() as session:
        session.execute(text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})
    with refused_as(code, match=revision):
        upgrade(platform.settings)


def test_a_change_that_leaves_a_row_without_its_parent_is_undone(platform: Platform) -> None:
    with refused_as("schema_broken_reference"):  # noqa: SIM117
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


def test_an_upgrade_of_an_upgraded_database_changes_nothing(platform: Platform) -> None:
    with platform.database.transaction() as session:
        session.execute(text("INSERT INTO queues VALUES ('ingest', 'paused')"))
    upgrade(platform.settings)
    with platform.database.reading() as session:
        assert session.execute(text("SELECT name, mode FROM queues")).all() == [("ingest", "paused")]


def test_a_ceiling_that_was_put_as_a_published_result_becomes_one(platform_on: Platform) -> None:
    phase_id = phase_of_rows(platform_on).phase.id
    columns = "id, phase_id, method, modality, source, created_ns"
    with schema_connection(platform_on.settings) as connection:
        command.downgrade(alembic_on(connection), "0031")
        for method, source in (("a", "stone ceiling --by rings, 7 frames"), ("b", "a paper on stone ceilings")):
            values = {"id": method * 32, "phase": phase_id, "method": method, "source": source}
            connection.execute(
                text(f"INSERT INTO reported ({columns}) VALUES (:id, :phase, :method, 'L', :source, 1)"), values
            )
    upgrade(platform_on.settings)
    with platform_on.database.reading() as session:
        kinds = session.execute(text("SELECT method, kind FROM reported ORDER BY method")).all()
    assert kinds == [("a", "ceiling"), ("b", "published")]


@pytest.mark.whole
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


@pytest.mark.whole
def test_downgrading_to_the_base_leaves_no_table(platform: Platform) -> None:
    with schema_connection(platform.settings) as connection:
        command.downgrade(alembic_on(connection), "base")
    assert tables_of(platform.settings) == {"alembic_version"}


def tables_of(settings: Settings) -> set[str]:
    database = Database(settings)
    names = set(inspect(database.engine).get_table_names())
    database.close()
    return names
