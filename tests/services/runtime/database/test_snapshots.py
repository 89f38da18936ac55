"""What a snapshot sees: the database as it was at its first statement, whatever is committed meanwhile."""

from contextlib import suppress

import pytest
from sqlalchemy import func, select
from sqlalchemy.exc import InternalError

from services.runtime.orm import Team
from services.runtime.platform import Platform


def test_a_snapshot_sees_nothing_that_is_committed_after_its_first_statement(platform_on: Platform) -> None:
    database, teams = platform_on.database, select(func.count()).select_from(Team)
    with database.snapshot() as session:
        assert session.scalar(teams) == 0
        with database.transaction() as other:
            other.add(Team(name="later"))
        assert session.scalar(teams) == 0
    with database.snapshot() as session:
        assert session.scalar(teams) == 1


def test_a_connection_that_served_a_snapshot_reads_what_is_newest_afterwards(platform_on: Platform) -> None:
    """Connections go back to one pool."""
    database, teams = platform_on.database, select(func.count()).select_from(Team)
    with database.snapshot() as session:
        session.scalar(teams)
    with database.reading() as session:
        before = session.scalar(teams)
        session.rollback()
        with database.transaction() as other:
            other.add(Team(name="later"))
        assert (before, session.scalar(teams)) == (0, 1)
        if not database.is_sqlite:
            with database.transaction() as other:
                other.add(Team(name="last"))
            assert session.scalar(teams) == 2


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
        assert session.scalar(select(func.count()).select_from(Team)) == 0
