"""No object is deleted while somebody reads what an earlier state of the database names.

**Conventions.** A hold is a row whose time is put off by a thread, on the database's clock. The collection asks
`is_held()` in the very statement that finds what it will delete: where no hold is seen, none was committed, so whoever
holds from now on sees a database in which those objects are named by nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

import structlog
from sqlalchemy import ColumnElement, delete, exists, insert, update
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.database import Database
from services.runtime.database_clock import database_ns
from services.runtime.errors import PlatformFaultError
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import CollectionHold
from services.runtime.orm.base import new_id

HELD_S = 300.0
RENEWED_S = 30.0

log = structlog.get_logger(__name__)


class HoldLostError(PlatformFaultError):
    """The hold could not be put off in time, so objects may have been deleted meanwhile."""

    code = "hold_lost"

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"the hold on the collection ({reason}) ran out after {HELD_S:g} s without the database; begin again"
        )


class Hold:
    """A hold under way; `check` when the work is done."""

    def __init__(self, database: Database, reason: str) -> None:
        self._database, self._reason, self.id = database, reason, new_id()
        self._is_lost = False

    def begin(self) -> None:
        with self._database.transaction() as session:
            until_ns = database_ns() + int(HELD_S * 1e9)
            session.execute(insert(CollectionHold).values(id=self.id, reason=self._reason, until_ns=until_ns))

    def renew(self) -> None:
        """Put it off; where it ran out already it is lost for good."""
        alive = update(CollectionHold).where(CollectionHold.id == self.id, CollectionHold.until_ns > database_ns())
        with self._database.transaction() as session:
            self._is_lost |= not rows_changed(session, alive.values(until_ns=database_ns() + int(HELD_S * 1e9)))

    def check(self) -> None:
        """Raises `HoldLostError` unless it has held all the time."""
        self.renew()
        if self._is_lost:
            raise HoldLostError(self._reason)

    def end(self) -> None:
        with self._database.transaction() as session:
            session.execute(delete(CollectionHold).where(CollectionHold.id == self.id))


def is_held() -> ColumnElement[bool]:
    """Whether anybody holds the collection, as part of a statement."""
    return exists().where(CollectionHold.until_ns > database_ns())


@contextmanager
def collection_held(database: Database, reason: str) -> Iterator[Hold]:
    """Nothing that any snapshot of the database taken inside names is deleted before the end."""
    hold, over = Hold(database, reason), Event()
    hold.begin()
    thread = Thread(target=_renew, args=(hold, over), name="hold", daemon=True)
    thread.start()
    try:
        yield hold
    finally:
        over.set()
        thread.join()
        hold.end()


def _renew(hold: Hold, over: Event) -> None:
    while not over.wait(RENEWED_S):
        try:
            hold.renew()
        except SQLAlchemyError as error:  # the next try may be in time; `check` knows
            log.warning("hold not renewed", reason=f"{type(error).__name__}: {error}"[:500])
