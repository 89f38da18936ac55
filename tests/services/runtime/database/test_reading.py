"""What sessions see that only read: a snapshot, lookups outside of transactions; and which platforms send wake-ups."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from sqlalchemy import func, select, text
from sqlalchemy.exc import InternalError, InvalidRequestError
from structlog.testing import capture_logs

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.orm import Team
from services.runtime.platform import Platform, open_platform, open_silent_platform
from services.runtime.settings import BrokerSettings, Settings
from testing.servers.fixtures import make_settings

TEAMS = select(func.count()).select_from(Team)


def test_a_snapshot_sees_nothing_that_is_committed_after_its_first_statement(platform_on: Platform) -> None:
    database = platform_on.database
    with database.snapshot() as session:
        assert session.scalar(TEAMS) == 0
        with database.transaction() as other:
            other.add(Team(name="later"))
        assert session.scalar(TEAMS) == 0
    with database.snapshot() as session:
        assert session.scalar(TEAMS) == 1


def test_a_connection_that_served_a_snapshot_reads_what_is_newest_afterwards(platform_on: Platform) -> None:
    """Connections go back to one pool."""
    database = platform_on.database
    with database.snapshot() as session:
        session.scalar(TEAMS)
    with database.reading() as session:
        before = session.scalar(TEAMS)
        session.rollback()
        with database.transaction() as other:
            other.add(Team(name="later"))
        assert (before, session.scalar(TEAMS)) == (0, 1)
        if not database.is_sqlite:
            with database.transaction() as other:
                other.add(Team(name="last"))
            assert session.scalar(TEAMS) == 2


@pytest.mark.parametrize("name", ["reading", "snapshot"])
def test_what_is_changed_while_reading_is_not_written(platform_on: Platform, name: str) -> None:
    database = platform_on.database
    with getattr(database, name)() as session:
        session.add(Team(name="forgotten"))
    with suppress(InternalError), getattr(database, name)() as session:
        session.add(Team(name="flushed"))
        session.flush()
        assert database.is_sqlite, "PostgreSQL refuses it"
    with database.reading() as session:
        assert session.scalar(TEAMS) == 0


def test_each_statement_sees_what_is_committed_by_then(platform_on: Platform) -> None:
    database = platform_on.database
    with database.lookups() as session:
        assert session.scalar(TEAMS) == 0
        with database.transaction() as other:
            other.add(Team(name="later"))
        assert session.scalar(TEAMS) == (0 if database.is_sqlite else 1), "SQLite reads on in one transaction"
    with database.lookups() as session:
        assert session.scalar(TEAMS) == 1


def test_on_postgresql_no_transaction_is_open_between_statements(on_postgres: Platform) -> None:
    database = on_postgres.database
    own = text("SELECT pg_backend_pid()")
    state = text("SELECT state FROM pg_stat_activity WHERE pid = :pid")
    seen = []
    for name in ("reading", "lookups"):
        with getattr(database, name)() as session, database.reading() as other:
            seen.append(other.scalar(state, {"pid": session.scalar(own)}))
    assert seen == ["idle in transaction", "idle"]


def test_a_connection_that_looked_up_takes_part_in_transactions_again(platform_on: Platform) -> None:
    """Connections go back to one pool."""
    database = platform_on.database
    with database.lookups() as session:
        session.scalar(TEAMS)
    with database.transaction() as session:
        session.add(Team(name="undone"))
        session.flush()
        session.rollback()
    with database.reading() as session:
        assert session.scalar(TEAMS) == 0


def test_rows_that_were_changed_are_refused_and_not_written(platform_on: Platform) -> None:
    database = platform_on.database
    with database.lookups() as session:
        session.add(Team(name="forgotten"))
    for act in ("flush", "commit"):
        with database.lookups() as session:
            session.add(Team(name="flushed"))
            with pytest.raises(InvalidRequestError):
                getattr(session, act)()
    with database.lookups() as session:
        assert session.scalar(TEAMS) == 0


AWAY = BrokerSettings("redis://127.0.0.1:1/0")
NOT_SENT = "wake-up not sent; the sweeper sends it again"


@pytest.mark.parametrize(("opening", "told"), [(open_platform, [NOT_SENT]), (open_silent_platform, [])])
def test_only_a_platform_with_workers_rings(
    tmp_path: Path, opening: Callable[[Settings], Platform], told: list[str]
) -> None:
    platform = opening(make_settings(tmp_path, broker=AWAY))
    with capture_logs() as logs, platform.database.transaction() as session:
        wake_up_after_commit(session, "labeler")
    assert [line["event"] for line in logs] == told
    platform.database.close()
