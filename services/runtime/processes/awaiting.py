"""A process may be started before what it stands on: it waits for a while, then says what is missing.

**Conventions.** Waiting is for outages only; what is refused (a newer schema, a wrong password) ends it at once.
"""

import time
from collections.abc import Callable
from typing import TypeVar

import structlog
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text
from sqlalchemy.exc import OperationalError

from services.runtime.database import Database
from services.runtime.errors import NewerSchemaError, PlatformFaultError
from services.runtime.migrate import MIGRATIONS
from services.runtime.settings import Settings

PAUSE_S = 1.0
OUTAGES: tuple[type[Exception], ...] = (OperationalError, PlatformFaultError)
T = TypeVar("T")

log = structlog.get_logger(__name__)


class SchemaMissingError(PlatformFaultError):
    """The database is not at the schema of this code."""

    code = "schema_missing"

    def __init__(self, stands: str, wanted: str) -> None:
        stood = f"at revision {stands!r}" if stands else "empty"
        super().__init__(
            f"the database is {stood} and this version works on {wanted!r}; "
            "has `python -m services.runtime.processes.prepare` of this version run?"
        )


def insist(act: Callable[[], T], within_s: float) -> T:
    """What `act` returns, tried again every second through outages; the last one is raised after `within_s`."""
    until_s = time.monotonic() + within_s
    while True:
        try:
            return act()
        except OUTAGES as outage:
            if time.monotonic() + PAUSE_S > until_s:
                raise
            log.warning("waiting", reason=f"{type(outage).__name__}: {outage}"[:300])
            time.sleep(PAUSE_S)


def await_schema(settings: Settings) -> None:
    """Return once the database is at the schema of this code, within `database.awaited_s`.

    Raises `SchemaMissingError`, `NewerSchemaError`, what the driver raises when the database stays away.
    """
    database = Database(settings)
    try:
        insist(lambda: _refuse_other_schema(database), settings.database.awaited_s)
    finally:
        database.close()


def _refuse_other_schema(database: Database) -> None:
    stands, script = _revision(database), ScriptDirectory(str(MIGRATIONS))
    wanted = str(script.get_current_head())
    if stands == wanted:
        return
    if stands and stands not in {known.revision for known in script.walk_revisions()}:
        raise NewerSchemaError(stands, wanted)
    raise SchemaMissingError(stands, wanted)


def _revision(database: Database) -> str:
    """Where the database stands; empty before the first revision."""
    with database.reading() as session:
        if not inspect(session.connection()).has_table("alembic_version"):
            return ""
        return str(session.scalar(text("SELECT version_num FROM alembic_version")) or "")
