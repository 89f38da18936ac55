"""Database migration: applies all missing schema revisions in one transaction.

**Conventions.** Any number of processes may start concurrently: one upgrades, the others wait and find nothing left to
do (PostgreSQL: an advisory lock; SQLite: the write lock taken at BEGIN). SQLite's foreign keys are off meanwhile, since
rebuilding a table (batch mode) would cascade into its children; they are checked before the commit.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, event, text

from services.runtime.database.transactions import Database
from services.runtime.settings import Settings
from stone.errors import Refused

MIGRATIONS = Path(__file__).with_name("migrations")
LAST_OF_OLDER = "1c1f180f"  # the last commit that upgrades databases older than the baseline
LOCK = 0x53544F4E45  # "STONE": key of the advisory lock


def upgrade(settings: Settings) -> None:
    """Upgrade the database of `settings` to the newest revision, if necessary.

    Raises `schema_newer` if a newer version of this code has migrated it, and `schema_older` if it is older than the
    baseline.
    Raises `schema_broken_reference` if a revision left a dangling reference; then nothing is changed.
    """
    with schema_connection(settings) as connection:
        stands = current_revision(connection)
        if stands == head_revision():
            return
        if stands:
            refuse_unknown(stands)
        command.upgrade(alembic_on(connection), "head")


def alembic_on(connection: Connection) -> Config:
    """Return the Alembic configuration for work in the connection's transaction."""
    return _configuration({"connection": connection})


def current_revision(connection: Connection) -> str:
    """Return the database's revision; empty before the first."""
    return MigrationContext.configure(connection).get_current_revision() or ""


def head_revision() -> str:
    """Return this code's revision."""
    return str(_revisions().get_current_head())


def refuse_unknown(revision: str) -> None:
    """Raise `schema_older` or `schema_newer` if this code has no such revision."""
    known = [each.revision for each in _revisions().walk_revisions()]  # the newest first
    if revision in known:
        return
    if revision < known[-1]:
        raise Refused(
            "schema_older",
            f"the database or backup is at revision {revision!r}, older than {known[-1]!r}. Restore and start it once "
            f"with the sources of commit {LAST_OF_OLDER}, then with this version",
        )
    raise Refused(
        "schema_newer",
        f"the database is at revision {revision!r}, which is newer than {known[0]!r} of this version; start the "
        "version that migrated it, or restore a backup",
    )


def _revisions() -> ScriptDirectory:
    return ScriptDirectory.from_config(_configuration({}))


def _configuration(attributes: dict[str, Any]) -> Config:
    # Not from alembic.ini, which could not name a folder with a % in its path.
    config = Config(attributes=attributes)
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    return config


@contextmanager
def schema_connection(settings: Settings) -> Iterator[Connection]:
    """Yield a connection in a transaction that excludes other schema changes, committed at the end."""
    database = Database(settings)
    try:
        if database.is_sqlite:
            event.listen(database.engine, "connect", _without_foreign_keys)
        with database.engine.execution_options(stone_writes=True).begin() as connection:
            if not database.is_sqlite:
                connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
            yield connection
            if database.is_sqlite:
                _refuse_broken_references(connection)
    finally:
        database.close()


def _without_foreign_keys(connection: Any, _record: object) -> None:
    connection.execute("PRAGMA foreign_keys=OFF")


def _refuse_broken_references(connection: Connection) -> None:
    for table, row, parent, _number in connection.execute(text("PRAGMA foreign_key_check")):
        raise Refused(
            "schema_broken_reference",
            f"row {row!s} of table {str(table)!r} refers to a row of {str(parent)!r} that does not exist; "
            "nothing was changed",
        )
