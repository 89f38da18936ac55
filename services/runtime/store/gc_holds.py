"""Garbage collection holds: no object is deleted while a reader needs an earlier database state.

**Conventions.** A hold is a row whose time is put off by a thread, on the database's clock. Garbage collection asks
`is_gc_held()` in the very statement that finds what it will delete: where no hold is seen, none was committed, so
whoever holds from now on sees a database in which those objects are named by nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

import structlog
from sqlalchemy import ColumnElement, delete, exists, insert, update
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.database.clock import database_ns
from services.runtime.database.transactions import Database
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import GcHoldRow
from services.runtime.orm.base import new_id
from stone.errors import PlatformFaultError

HELD_S = 300.0
RENEWED_S = 30.0

log = structlog.get_logger(__name__)


class GcHoldLostError(PlatformFaultError):
    """The hold could not be put off in time, so objects may have been deleted meanwhile."""

    code = "hold_lost"

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"the hold on garbage collection ({reason}) ran out after {HELD_S:g} s without the database; begin again"
        )


class GcHold:
    """A hold under way; `check` when the work is done."""

    def __init__(self, database: Database, reason: str) -> None:
        self._database, self._reason, self.id = database, reason, new_id()
        self._is_lost = False

    def begin(self) -> None:
        with self._database.transaction() as session:
            until_ns = database_ns() + int(HELD_S * 1e9)
            session.execute(insert(GcHoldRow).values(id=self.id, reason=self._reason, until_ns=until_ns))

    def renew(self) -> None:
        """Put it off; where it ran out already it is lost for good."""
        alive = update(GcHoldRow).where(GcHoldRow.id == self.id, GcHoldRow.until_ns > database_ns())
        with self._database.transaction() as session:
            self._is_lost |= not rows_changed(session, alive.values(until_ns=database_ns() + int(HELD_S * 1e9)))

    def check(self) -> None:
        """Raises `GcHoldLostError` unless it has held all the time."""
        self.renew()
        if self._is_lost:
            raise GcHoldLostError(self._reason)

    def end(self) -> None:
        with self._database.transaction() as session:
            session.execute(delete(GcHoldRow).where(GcHoldRow.id == self.id))


def is_gc_held() -> ColumnElement[bool]:
    """Whether anybody holds garbage collection, as part of a statement."""
    return exists().where(GcHoldRow.until_ns > database_ns())


@contextmanager
def gc_hold(database: Database, reason: str) -> Iterator[GcHold]:
    """Hold garbage collection: nothing that a snapshot taken inside names is deleted before the end."""
    hold, over = GcHold(database, reason), Event()
    hold.begin()
    thread = Thread(target=_renew, args=(hold, over), name="hold", daemon=True)
    thread.start()
    try:
        yield hold
    finally:
        over.set()
        thread.join()
        hold.end()


def _renew(hold: GcHold, over: Event) -> None:
    while not over.wait(RENEWED_S):
        try:
            hold.renew()
        except SQLAlchemyError as error:  # the next try may be in time; `check` knows
            log.warning("hold not renewed", reason=f"{type(error).__name__}: {error}"[:500])
