"""The sweeper's records: times of its chores, its counters, and measured figures.

**Conventions.** The last sweeper to do a chore sets its time; ages use the database's clock. The size of the store is
summed in steps of `STEP_BLOBS`, so every query stays short; the figure is that of the last complete pass.
"""

import time
from threading import Lock

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import Blob, ChoreRow, FigureRow
from services.runtime.platform import Platform
from services.runtime.telemetry.counter_rows import CounterWriter
from services.runtime.telemetry.counters import process_counters

STEP_BLOBS = 50_000
STORED_BYTES, STORED_BLOBS = "stored_bytes", "stored_blobs"


class ChoreLedger:
    """Times of finished chores: any thread calls `note(name)`, one thread calls `write()` every few seconds."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._done_s: dict[str, float] = {}
        self._guard = Lock()
        self._row = CounterWriter(process_counters())

    def note(self, name: str) -> None:
        with self._guard:
            self._done_s[name] = time.monotonic()

    def write(self) -> None:
        """Write the noted times; after a failure they are kept for the next call."""
        now_s = time.monotonic()
        with self._guard:
            done_s, self._done_s = self._done_s, {}
        try:
            with self._platform.database.transaction() as session:
                for name, one_s in done_s.items():
                    _write_chore(session, name, int((now_s - one_s) * 1e9))
                committed = self._row.tell(session)
        except BaseException:
            with self._guard:
                self._done_s = {**done_s, **self._done_s}
            raise
        committed()


class StoreSum:
    """The size of the store: `step()` adds a few more blobs, and writes the sum after the last."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._after, self._bytes, self._blobs = "", 0, 0

    def step(self, most: int = STEP_BLOBS) -> None:
        some = select(Blob.sha256, Blob.size_bytes).where(Blob.sha256 > self._after).order_by(Blob.sha256).limit(most)
        part = some.subquery()
        whole = select(func.count(), func.coalesce(func.sum(part.c.size_bytes), 0), func.max(part.c.sha256))
        with self._platform.database.reading() as session:
            blobs, size_bytes, last = session.execute(whole.select_from(part)).one()
        self._blobs, self._bytes = self._blobs + blobs, self._bytes + int(size_bytes)
        if blobs == most:
            self._after = last
            return
        with self._platform.database.transaction() as session:
            _write_figure(session, STORED_BYTES, self._bytes)
            _write_figure(session, STORED_BLOBS, self._blobs)
        self._after, self._bytes, self._blobs = "", 0, 0


def _write_chore(session: Session, name: str, age_ns: int) -> None:
    done_ns = database_ns() - age_ns
    if not rows_changed(session, update(ChoreRow).where(ChoreRow.name == name).values(done_ns=done_ns)):
        session.add(ChoreRow(name=name, done_ns=done_ns))


def _write_figure(session: Session, name: str, value: int) -> None:
    values = {"value": value, "measured_ns": database_ns()}
    if not rows_changed(session, update(FigureRow).where(FigureRow.name == name).values(**values)):
        session.add(FigureRow(name=name, **values))
