"""A connection that was lost while nobody used it is replaced unnoticed, and one that lives is not asked whether."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import select, text

from benchmarks.rows.claiming.server_log import LOGGING
from services.runtime.database.transactions import Database
from services.runtime.settings import DatabaseSettings
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer, running_postgres


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    """A server of the module's own, which may be ended."""
    with running_postgres(**LOGGING) as running:
        yield running


@pytest.fixture
def database(server: PostgresServer, tmp_path: Path) -> Iterator[Database]:
    made = Database(make_settings(tmp_path, database=DatabaseSettings(server.url())))
    yield made
    made.close()


def one(database: Database) -> int:
    with database.transaction() as session:
        return session.scalar(select(1)) or 0


def test_a_server_that_ended_and_came_again_is_not_noticed(server: PostgresServer, database: Database) -> None:
    with database.transaction() as first, database.reading() as second:  # two connections wait in the pool afterwards
        assert (first.scalar(select(1)), second.scalar(select(1))) == (1, 1)
    server.kill()
    server.start()
    with database.transaction() as first, database.reading() as second:
        assert (first.scalar(select(1)), second.scalar(select(1))) == (1, 1)


def test_a_connection_that_the_server_closed_is_replaced(server: PostgresServer, database: Database) -> None:
    one(database)
    server.run(
        "SELECT pg_terminate_backend(pid, 60000) FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND datid > 0"
    )
    assert one(database) == 1


def test_what_a_server_says_unasked_is_no_end(server: PostgresServer, database: Database) -> None:
    with database.engine.connect() as connection:
        pid = connection.scalar(text("SELECT pg_backend_pid()"))
    server.run(f"SELECT pg_cancel_backend({pid})")
    server.run("ALTER SYSTEM SET application_name TO 'renamed'")
    server.run("SELECT pg_reload_conf()")  # which is reported on every connection
    with database.engine.connect() as connection:
        assert connection.scalar(text("SELECT pg_backend_pid()")) == pid
