"""Sessions that only look up: outside of any transaction on PostgreSQL, and unable to write."""

from pathlib import Path

import pytest
from sqlalchemy import func, select, text
from sqlalchemy.exc import InvalidRequestError

from services.runtime.orm import Team
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from testing.servers.fixtures import make_settings, opened

TEAMS = select(func.count()).select_from(Team)


def test_each_statement_sees_what_is_committed_by_then(platform_on: Platform) -> None:
    database = platform_on.database
    with database.lookups() as session:
        assert session.scalar(TEAMS) == 0
        with database.transaction() as other:
            other.add(Team(name="later"))
        assert session.scalar(TEAMS) == (0 if database.is_sqlite else 1), "SQLite reads on in one transaction"
    with database.lookups() as session:
        assert session.scalar(TEAMS) == 1


def test_on_postgresql_no_transaction_is_open_between_statements(tmp_path: Path, fresh_postgres_url: str) -> None:
    database = opened(make_settings(tmp_path, database=DatabaseSettings(fresh_postgres_url)), []).database
    own = text("SELECT pg_backend_pid()")
    state = text("SELECT state FROM pg_stat_activity WHERE pid = :pid")
    seen = []
    for name in ("reading", "lookups"):
        with getattr(database, name)() as session, database.reading() as other:
            seen.append(other.scalar(state, {"pid": session.scalar(own)}))
    database.close()
    assert seen == ["idle in transaction", "idle"]


def test_rows_that_were_changed_are_refused_and_not_written(platform_on: Platform) -> None:
    database = platform_on.database
    with database.lookups() as session:
        session.add(Team(name="forgotten"))
    for act in ("flush", "commit"):
        with database.lookups() as session:
            session.add(Team(name="flushed"))
            with pytest.raises(InvalidRequestError, match="only looks up"):
                getattr(session, act)()
    with database.lookups() as session:
        assert session.scalar(TEAMS) == 0


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
