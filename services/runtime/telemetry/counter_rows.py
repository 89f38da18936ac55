"""Counters as rows: each process writes its own, the metrics endpoint sums them.

**Conventions.** Workers start and stop with the load and have no HTTP endpoint; the API exposes their counters. A row
contains the counts of its process since the row was created. The heartbeat writes it, only if it grew. A row unchanged
for `FOLDED_AFTER_S` is folded into one total, so the sum never falls. If a folded process was merely idle, it creates
another row that starts at its last written counts. A killed process loses its counts since the last heartbeat: counters
serve for graphs, the rows of jobs are exact.
"""

from collections.abc import Callable

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import CounterRow, new_id
from services.runtime.platform import Platform
from services.runtime.telemetry.counters import Counts, ProcessCounters, less, summed

FOLDED = "0" * 32
FOLDED_AFTER_S = 600.0
MOST_FOLDED = 1000


class CounterWriter:
    """The row of one process's counters; only one thread at a time may write it."""

    def __init__(self, *sources: ProcessCounters) -> None:
        self._sources = sources
        self._id = new_id()
        self._is_there = False
        self._base: Counts = {}
        self._told: Counts = {}

    def counted(self) -> Counts:
        return summed(source.counts() for source in self._sources)

    def tell(self, session: Session) -> Callable[[], None]:
        """Write the increments in the caller's transaction; return a function to call after its commit."""
        now = self.counted()
        if now == self._told:
            return _nothing
        row_id, base = self._id, self._base
        if not _rewrite(session, row_id, less(now, base)):
            if self._is_there:  # folded meanwhile, with its last written counts
                row_id, base = new_id(), self._told
            session.add(CounterRow(id=row_id, counts=less(now, base), told_ns=database_ns()))

        def committed() -> None:
            self._id, self._base, self._told, self._is_there = row_id, base, now, True

        return committed

    def handed_over(self) -> tuple[Counts, Callable[[], None]]:
        """Return the increments and a function to call when another process has them; a new row starts there."""
        now = self.counted()

        def taken() -> None:
            self._id, self._base, self._told, self._is_there = new_id(), now, now, False

        return ({}, _nothing) if now == self._told else (less(now, self._told), taken)


def counters_of_all_processes(session: Session) -> Counts:
    """Return the sum of all processes' counters, including ended processes."""
    return summed(session.scalars(select(CounterRow.counts)))


def fold(platform: Platform, quiet_s: float = FOLDED_AFTER_S) -> int:
    """Fold rows unchanged for `quiet_s` into one; return their number."""
    quiet = select(CounterRow).where(CounterRow.id != FOLDED, CounterRow.told_ns < database_ns() - int(quiet_s * 1e9))
    with platform.database.transaction() as session:
        into = session.scalar(select(CounterRow).where(CounterRow.id == FOLDED).with_for_update())
        rows = session.scalars(quiet.order_by(CounterRow.id).limit(MOST_FOLDED).with_for_update(skip_locked=True)).all()
        if not rows:
            return 0
        if into is None:
            into = CounterRow(id=FOLDED, counts={})
            session.add(into)
        into.counts, into.told_ns = summed([into.counts, *(row.counts for row in rows)]), database_ns()
        session.execute(delete(CounterRow).where(CounterRow.id.in_([row.id for row in rows])))
    return len(rows)


def _rewrite(session: Session, row_id: str, counts: Counts) -> bool:
    row = update(CounterRow).where(CounterRow.id == row_id).values(counts=counts, told_ns=database_ns())
    return rows_changed(session, row) == 1


def _nothing() -> None:
    pass
