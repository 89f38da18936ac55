"""Garbage collection holds: no object is deleted while a reader needs an earlier database state.

**Conventions.** A hold is a row whose time is put off by a thread, on the database's clock. Garbage collection asks
`is_gc_held()` in the very statement that finds what it will delete: where no hold is seen, none was committed, so
whoever holds from now on sees a database in which those objects are named by nothing.
"""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from threading import Event, Thread
from typing import Generic, TypeVar

import structlog
from sqlalchemy import ColumnElement, delete, exists, insert, update
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.database.clock import database_ns
from services.runtime.database.transactions import Database
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import GcHoldRow
from services.runtime.orm.base import new_id
from services.runtime.store.protocol import StoredObject
from stone.errors import PlatformFaultError

HELD_S = 300.0
RENEWED_S = 30.0

log = structlog.get_logger(__name__)


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
        """Raises `hold_lost` unless it has held all the time."""
        self.renew()
        if self._is_lost:
            raise PlatformFaultError(
                "hold_lost",
                f"the hold on garbage collection ({self._reason}) expired after {HELD_S:g} s without the "
                "database; start again",
            )

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


# The cursor of garbage collection, which looks at a slice of the blobs each time, and walks through long listings.
#
# **Conventions.** Other chores wait for the end of a turn, so none may last long. Blobs are looked at in the order of
# their contents, objects by the first byte of that; where a turn ended is forgotten with the process.


SHARE_S = 5.0
DELETING_S = 20.0
SLICE = 20_000
SHARDS = 256
LISTED = 5000
WORKSPACES = 200

T = TypeVar("T")


@dataclass
class ListingWalk(Generic[T]):
    """A walk through what is listed one by one, over several turns."""

    _left: Iterator[T] | None = None

    def turn(self, listed: Iterable[T], most: int) -> list[T]:
        """At most so many. `listed` is begun where the last turn came to the end, or could not go on."""
        left = iter(listed) if self._left is None else self._left
        self._left = None
        found = list(islice(left, most))
        if len(found) == most:
            self._left = left
        return found


@dataclass
class GcCursor:
    """The blobs after `after_sha256` are next, `slice_rows` at a time until `share_s` have passed, at least once.

    What is condemned is deleted until `deleting_s` have passed; of objects under way `listed` are looked at.
    """

    share_s: float = SHARE_S
    slice_rows: int = SLICE
    after_sha256: str = ""
    shard: int = 0
    deleting_s: float = DELETING_S
    listed: int = LISTED
    workspaces: int = WORKSPACES
    of_uploads: ListingWalk[StoredObject] = field(default_factory=ListingWalk)
    of_work: ListingWalk[tuple[str, list[int]]] = field(default_factory=ListingWalk)

    def until_s(self) -> float:
        """When this time's share will be used up, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def next_shard(self, prefix: str) -> str:
        """The keys below `prefix` whose content begins with one byte, another one each time."""
        shard, self.shard = self.shard, (self.shard + 1) % SHARDS
        return f"{prefix}{shard:02x}/"


def whole_cursor() -> GcCursor:
    """One whose turn looks at everything."""
    forever_s, all_there_is = float("inf"), 2**63 - 1
    return GcCursor(forever_s, deleting_s=forever_s, listed=all_there_is, workspaces=all_there_is)
