"""The scrub: reads the whole store slowly and repeatedly, and compares every object with its blob's row.

**Conventions.** A turn reads for at most `TURN_S` and about `TURN_BYTES`. A pause after each object keeps the mean rate
over a few objects at `STONE_STORE__SCRUB_BYTES_PER_S`. A large object is read over several turns without a pause;
otherwise it would never be read between two restarts. A row stores the position of the pass: after kill −9 it continues
at the last turn's end. Two sweepers read the same objects independently, and only one of them advances the pass. Noted
faults are checked first.

A bucket is read only if `STONE_STORE__SCRUBS_BUCKET` is set: reading costs money, and an object store with several
disks compares its own bytes.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

import structlog
from sqlalchemy import delete, exists, select, update
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import Blob, StoreFault, StoreScrub
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.faults import BYTES, MISSING, SERVED, SIZE, UNREADABLE, forget, note
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.protocol import Store

TURN_S = 0.5
TURN_BYTES = 16 * 2**20
CREDIT_S = 1.0
LEAST_BYTES = 32 * 2**10
"""The least that one object counts for, because opening it costs time too."""
AHEAD = 200
AGAIN_S = 3600.0
"""The least time until a noted fault is checked again, and until the next pass starts."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class _Due:
    """An object to read; `is_noted` if it has a noted fault and is not part of the pass."""

    sha256: str
    object_key: str
    size_bytes: int
    is_noted: bool


@dataclass
class _Reading:
    """An object that is being read, over several turns if it is large."""

    due: _Due
    pieces: Iterator[bytes]
    fault: str = ""
    digest: Any = field(default_factory=sha256)

    def step(self) -> int | None:
        """Read one piece and return its size, or None at the end."""
        piece = b""
        with self._noting():
            piece = b"" if self.fault else next(self.pieces, b"")
        self.digest.update(piece)
        if piece:
            return len(piece)
        if not self.fault and self.digest.hexdigest() != self.due.sha256:
            self.fault = BYTES
        return None

    @contextmanager
    def _noting(self) -> Iterator[None]:
        try:
            yield
        except ObjectMissingError:
            self.fault = MISSING
        except OSError as error:
            if error.errno not in UNREADABLE:
                raise
            self.fault = BYTES

    @classmethod
    def of(cls, store: Store, due: _Due) -> "_Reading":
        """Return the object, opened. Raises `store_unavailable`."""
        opened = cls(due, iter(()))
        with opened._noting():
            if store.size_bytes(due.object_key) != due.size_bytes:
                opened.fault = SIZE
            else:
                opened.pieces = iter(store.read(due.object_key))
        return opened


class Scrub:
    """The scrub of one sweeper; each `turn()` continues the pass if it is due."""

    def __init__(self, platform: Platform, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._platform, self._now_s = platform, monotonic_s
        self._rate = rate_of(platform.settings.store)
        self._paid_s = self._pass_s = monotonic_s() - CREDIT_S
        self._again_s: dict[str, float] = {}
        self._noted: deque[_Due] = deque()
        self._ahead: deque[_Due] = deque()
        self._reading: _Reading | None = None

    def turn(self) -> None:
        """Continue the pass. Raises `store_unavailable`; the next turn then starts the unfinished object again."""
        if not self._rate:
            return
        self._paid_s = max(self._paid_s, self._now_s() - CREDIT_S)
        with self._platform.database.reading() as session:
            row = session.get(StoreScrub, 1)
            self._look_at_noted(session)
        after, done = row.after_sha256 if row else "", list[_Reading]()
        try:
            self._read(after, done)
        except BaseException:
            self._ahead.clear()
            raise
        finally:
            self._write(after, done)

    def _read(self, after: str, done: list[_Reading]) -> None:
        until_s, left = self._now_s() + TURN_S, TURN_BYTES
        while left > 0 and self._now_s() < until_s:
            reading = self._reading or self._next(after, done)
            if reading is None:
                return
            self._reading = None  # after a store error the object starts again
            if (size := reading.step()) is not None:
                left, self._reading = left - size, reading
            else:
                self._paid_s += max(reading.due.size_bytes, LEAST_BYTES) / self._rate
                done.append(reading)

    def _next(self, after: str, done: list[_Reading]) -> _Reading | None:
        """Return the next object, opened; None at the end of the pass, and during the pause after a read."""
        if self._noted:
            return _Reading.of(self._platform.store, self._noted.popleft())
        if max(self._paid_s, self._pass_s) > self._now_s():
            return None
        if not self._ahead:
            last = next((read.due.sha256 for read in reversed(done) if not read.due.is_noted), after)
            with self._platform.database.reading() as session:
                blobs = session.scalars(select(Blob).where(Blob.sha256 > last).order_by(Blob.sha256).limit(AHEAD))
                self._ahead.extend(_due(blob, is_noted=False) for blob in blobs)
        return _Reading.of(self._platform.store, self._ahead.popleft()) if self._ahead else None

    def _look_at_noted(self, session: Session) -> None:
        """Queue noted faults for another check: faults met by readers at once, other faults once per `AGAIN_S`."""
        now_s = self._now_s()
        oldest = select(StoreFault).order_by(StoreFault.found_ns).limit(AHEAD)
        faults = {row.sha256: row.fault for row in session.scalars(oldest)}
        self._again_s = {sha256: self._again_s.get(sha256, 0.0) for sha256 in faults}
        wanted = [sha256 for sha256, fault in faults.items() if fault == SERVED or self._again_s[sha256] <= now_s]
        due = session.scalars(select(Blob).where(Blob.sha256.in_(wanted))).all() if wanted else ()
        self._again_s |= dict.fromkeys(wanted, now_s + AGAIN_S)
        waiting = {noted.sha256 for noted in self._noted} | ({self._reading.due.sha256} if self._reading else set())
        self._noted.extend(_due(blob, is_noted=True) for blob in due if blob.sha256 not in waiting)

    def _write(self, after: str, done: list[_Reading]) -> None:
        """Write the faults and the position of the pass; if another sweeper moved it, continue at the new position."""
        of_pass = [reading.due for reading in done if not reading.due.is_noted]
        is_over = self._is_over(of_pass[-1].sha256 if of_pass else after)
        if not done and not is_over:
            return
        with self._platform.database.transaction() as session:
            insert_new(session, StoreScrub, [{"id": 1}])
            for reading in done:
                _conclude(session, reading)
            if of_pass and not _move_on(session, after, of_pass):
                self._ahead.clear()
                self._reading = None
            elif is_over:
                _end_pass(session)
                self._pass_s = self._now_s() + AGAIN_S

    def _is_over(self, last: str) -> bool:
        """Return whether the pass has read every object."""
        if self._ahead or self._reading or self._now_s() < self._pass_s:
            return False
        with self._platform.database.reading() as session:
            return not session.scalar(select(exists().where(Blob.sha256 > last)))


def rate_of(store: StoreSettings) -> int:
    """Return the scrub rate in bytes a second; 0 if the store is not scrubbed."""
    return 0 if store.s3_bucket and not store.scrubs_bucket else store.scrub_bytes_per_s


def _due(blob: Blob, *, is_noted: bool) -> _Due:
    return _Due(blob.sha256, blob.object_key, blob.size_bytes, is_noted)


def _conclude(session: Session, read: _Reading) -> None:
    """Write the fault, or delete the noted fault; skip a blob that garbage collection has deleted since."""
    if not read.fault:
        forget(session, [read.due.sha256])
    elif session.scalar(select(Blob.object_key).where(Blob.sha256 == read.due.sha256)) == read.due.object_key:
        note(session, read.due, read.fault, "scrub")


def _move_on(session: Session, after: str, read: list[_Due]) -> bool:
    values = {
        "after_sha256": read[-1].sha256,
        "objects": StoreScrub.objects + len(read),
        "size_bytes": StoreScrub.size_bytes + sum(reading.size_bytes for reading in read),
    }
    return bool(rows_changed(session, update(StoreScrub).where(StoreScrub.after_sha256 == after).values(**values)))


def _end_pass(session: Session) -> None:
    row = session.get_one(StoreScrub, 1, populate_existing=True)
    log.info("store scrubbed", objects=row.objects, size_bytes=row.size_bytes)
    row.after_sha256, row.objects, row.size_bytes = "", 0, 0
    row.passed_ns = row.begun_ns = now_ns()
    gone = ~exists().where(Blob.sha256 == StoreFault.sha256)
    session.execute(delete(StoreFault).where(gone).execution_options(synchronize_session=False))
