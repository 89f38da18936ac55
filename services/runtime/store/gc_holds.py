"""Garbage collection holds: no object is deleted while a reader needs an earlier database state.

**Conventions.** A hold is a row whose expiry a thread renews, on the database's clock. Garbage collection checks
`is_gc_held()` in the very statement that selects what it will delete. If that statement sees no hold, none was
committed, and later holders see a database in which no row names those objects.
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
    """An active hold; call `check` when the work is done."""

    def __init__(self, database: Database, reason: str) -> None:
        self._database, self._reason, self.id = database, reason, new_id()
        self._is_lost = False

    def begin(self) -> None:
        with self._database.transaction() as session:
            until_ns = database_ns() + int(HELD_S * 1e9)
            session.execute(insert(GcHoldRow).values(id=self.id, reason=self._reason, until_ns=until_ns))

    def renew(self) -> None:
        """Renew the hold; a hold that has expired is lost for good."""
        alive = update(GcHoldRow).where(GcHoldRow.id == self.id, GcHoldRow.until_ns > database_ns())
        with self._database.transaction() as session:
            self._is_lost |= not rows_changed(session, alive.values(until_ns=database_ns() + int(HELD_S * 1e9)))

    def check(self) -> None:
        """Raise `hold_lost` unless the hold lasted all the time."""
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
    """Return whether any process holds garbage collection, as part of a statement."""
    return exists().where(GcHoldRow.until_ns > database_ns())


@contextmanager
def gc_hold(database: Database, reason: str) -> Iterator[GcHold]:
    """Hold garbage collection: objects named by a snapshot taken in the block stay until its end."""
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
        except SQLAlchemyError as error:  # the next try may be in time; `check` decides
            log.warning("hold not renewed", reason=f"{type(error).__name__}: {error}"[:500])


# The cursor of garbage collection, which processes a slice of the blobs each time, and walks through long listings.
#
# **Conventions.** Other chores wait for the end of a turn, so every turn must be short. Blobs are processed in the
# order of their contents, objects by the first byte of their content. The process keeps the cursor in memory only.


SHARE_S = 5.0
DELETING_S = 20.0
SLICE = 20_000
SHARDS = 256
LISTED = 5000
WORKSPACES = 200

T = TypeVar("T")


@dataclass
class ListingWalk(Generic[T]):
    """A walk through a listing, over several turns."""

    _left: Iterator[T] | None = None

    def turn(self, listed: Iterable[T], most: int) -> list[T]:
        """Return up to `most` entries. `listed` starts anew if the last turn reached its end or could not continue."""
        left = iter(listed) if self._left is None else self._left
        self._left = None
        entries = list(islice(left, most))
        if len(entries) == most:
            self._left = left
        return entries


@dataclass
class GcCursor:
    """The next blobs are those after `after_sha256`, `slice_rows` at a time until `share_s` have passed, at least once.

    Condemned objects are deleted until `deleting_s` have passed; `listed` unfinished objects are checked.
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
        """Return the end of this turn's share, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def next_shard(self, prefix: str) -> str:
        """Return a prefix below `prefix` for one first byte of the content, another byte each time."""
        shard, self.shard = self.shard, (self.shard + 1) % SHARDS
        return f"{prefix}{shard:02x}/"


def whole_cursor() -> GcCursor:
    """Return a cursor whose turn processes everything."""
    forever_s, all_there_is = float("inf"), 2**63 - 1
    return GcCursor(forever_s, deleting_s=forever_s, listed=all_there_is, workspaces=all_there_is)
