"""A database in memory whose transactions fail at random and start when the scheduler picks them.

**Conventions.** Faults have three kinds; a calm world has none.

- *away*: the transaction is refused at its start.
- *cut*: the connection ends at a statement, or at COMMIT before it takes effect.
- *unanswered*: COMMIT takes effect, but its answer and the following wake-ups are lost.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from sqlalchemy import Engine, create_engine, delete, event
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from sqlalchemy.pool import StaticPool

from chaos.seeds.scheduler import Scheduler
from services.runtime.database.transactions import Database, sqlite_engine
from services.runtime.orm import Base, FigureRow, Job, JobAttempt, JobLine, JobNeed, Queue, User
from services.runtime.orm.notifications import NotificationEvent
from services.runtime.settings import Settings

OWNER = "0" * 32
WRITTEN = (NotificationEvent, FigureRow, JobLine, JobNeed, JobAttempt, Job, Queue)
LONGEST = 12
"""A cut connection ends at one of its first `LONGEST` statements, or at COMMIT."""


class OutageError(OperationalError):
    """A drawn fault; any other exception of the database is a fault of the platform."""

    def __init__(self, at: str) -> None:
        super().__init__(at, {}, OSError("server closed the connection unexpectedly"))


class FaultyDatabase(Database):
    """`share` is the share of transactions that fail; `away_until_s` is the time at which the database returns."""

    def __init__(self, settings: Settings, scheduler: Scheduler, wake_up: Callable[[str, int], None]) -> None:
        super().__init__(settings, self._send, memory())
        self._scheduler, self._dice, self._then = scheduler, scheduler.dice, wake_up
        self._cut_in: int | None = None
        self._is_unanswered = False
        self.share = 0.0
        self.away_until_s = 0.0
        self.transactions = 0
        self.heard: dict[tuple[str, int], float] = {}
        event.listen(self.engine, "before_cursor_execute", self._count_down)

    def close(self) -> None:
        """Detach from the engine, whose memory the next history uses."""
        event.remove(self.engine, "before_cursor_execute", self._count_down)

    @contextmanager
    def transaction(self) -> Iterator[Session]:
        is_cut, is_unanswered = self._begin()
        self._cut_in, self._is_unanswered = (self._dice.randrange(LONGEST) if is_cut else None), is_unanswered
        try:
            with super().transaction() as session:
                yield session
                if is_cut:
                    raise OutageError("COMMIT")
        finally:
            self._cut_in = None
        if is_unanswered:
            raise OutageError("COMMIT, unanswered")

    @contextmanager
    def reading(self) -> Iterator[Session]:
        self._begin()
        with super().reading() as session:
            yield session

    @contextmanager
    def looking_on(self) -> Iterator[Session]:
        """Yield a session like `reading`, for the judge: no step, no fault."""
        with super().reading() as session:
            yield session

    def _begin(self) -> tuple[bool, bool]:
        """Wait for the turn; return whether to cut the transaction, and whether to lose its answer.

        Raises `OutageError`.
        """
        late_s = self._dice.choice((0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.3)) if self.share else 0.0
        self._scheduler.pause(late_s)
        self.transactions += 1
        drawn = self._dice.random() / self.share if self.share else 1.0
        if self._scheduler.now_s < self.away_until_s or drawn < 0.2:
            raise OutageError("BEGIN")
        is_cut, is_unanswered = drawn < 0.6, 0.6 <= drawn < 1.0
        task = self._scheduler.current
        if task.name.startswith("reporter-") and not is_cut:
            self.heard[task.process.attempt] = self._scheduler.now_s
        return is_cut, is_unanswered

    def _send(self, queue: str, times: int) -> None:
        if not self._is_unanswered:
            self._then(queue, times)

    def _count_down(self, *_: Any) -> None:
        if self._cut_in is not None:
            self._cut_in -= 1
            if self._cut_in < 0:
                raise OutageError("a statement")


@cache
def memory() -> Engine:
    """Return the engine of this process; all its sessions share one connection, so use one at a time."""
    engine = sqlite_engine(create_engine("sqlite://", poolclass=StaticPool, hide_parameters=True))
    Base.metadata.create_all(engine)
    with Session(engine) as session:
        session.add(User(id=OWNER, name="ada", role="curator"))
        session.commit()
    return engine


def clear() -> None:
    """Delete the rows of a history."""
    with Session(memory()) as session:
        for row in WRITTEN:
            session.execute(delete(row))
        session.commit()
