"""Retries at process start until dependencies are available, then reports the missing ones.

**Conventions.** Only outages are waited for; a refusal (a newer schema, a wrong password) ends the process at once.
"""

import sys
import time
from collections.abc import Callable
from typing import TypeVar

import structlog
from sqlalchemy.exc import OperationalError

from services.runtime.database.migrate import current_revision, head_revision, refuse_unknown
from services.runtime.database.transactions import Database
from services.runtime.settings import Settings
from services.runtime.telemetry.log_lines import speak_json
from stone.errors import PlatformFaultError, StoneError

PAUSE_S = 1.0
OUTAGES: tuple[type[Exception], ...] = (OperationalError, PlatformFaultError)
T = TypeVar("T")

log = structlog.get_logger(__name__)


def schema_missing(stands: str, wanted: str) -> PlatformFaultError:
    stood = f"at revision {stands!r}" if stands else "empty"
    return PlatformFaultError(
        "schema_missing",
        f"the database is {stood}, but this version requires {wanted!r}; "
        "run `python -m services.runtime.processes.prepare` of this version",
    )


def insist(act: Callable[[], T], within_s: float) -> T:
    """Call `act` until it succeeds, every second during outages; raise the last error after `within_s`."""
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
    """Return once the database has the schema of this code, within `database.awaited_s`.

    Raises `schema_missing`, `schema_newer`, `schema_older`, or the driver's error if the database stays unavailable.
    """
    database = Database(settings)
    try:
        insist(lambda: _refuse_other_schema(database), settings.database.awaited_s)
    finally:
        database.close()


def _refuse_other_schema(database: Database) -> None:
    with database.reading() as session:
        stands, wanted = current_revision(session.connection()), head_revision()
    if stands == wanted:
        return
    if stands:
        refuse_unknown(stands)
    raise schema_missing(stands, wanted)


try:
    Settings()
except StoneError as refusal:
    speak_json()
    structlog.get_logger(__name__).error("not started", code=refusal.code, reason=str(refusal))
    sys.exit(1)
