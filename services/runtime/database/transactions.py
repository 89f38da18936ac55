"""Database transactions on SQLite (WAL) or PostgreSQL, and the wake-ups sent after their commit.

**Conventions.** `transaction()` is for writing. On SQLite it takes the write lock at BEGIN, so two writers wait for
each other instead of failing half-way; it commits at the end or rolls back completely. `reading()` is read-only. So are
`snapshot()`, in which later statements see nothing newer than the first, and `lookups()`, for the most frequent
queries. Do no slow work within a transaction. A rollback drops the wake-ups of `wake_up_after_commit`. One `Database`
belongs to one process: a forked child makes its own (`services/runtime/platform.py`).

On PostgreSQL, reads are READ ONLY transactions that end with COMMIT. On a ROLLBACK psycopg 3.3 discards all prepared
statements of the connection, so that each later statement would be parsed and planned again.

A server that shuts down notifies its connections before it closes them. A connection without unread data is therefore
used as it is, and only a connection with unread data is pinged. Checking the socket costs the server nothing, while a
ping would be a transaction before each transaction.
"""

import select
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import InvalidatePoolError, InvalidRequestError, OperationalError, SQLAlchemyError
from sqlalchemy.orm import Session

from services.runtime.database.ballast import Ballast, is_full
from services.runtime.settings import Settings

WakeUp = Callable[[str, int], None]
WAKE_UPS = "wake_ups"
CONNECT_S = 5
SNAPSHOT = "REPEATABLE READ"  # PostgreSQL: nothing newer than the first statement is seen
EACH_ALONE = "AUTOCOMMIT"  # PostgreSQL: every statement is a transaction


class Database:
    """`with database.transaction() as session: …`; `wake_up(queue, times)` is called after the commit."""

    def __init__(
        self, settings: Settings, wake_up: WakeUp = lambda queue, times: None, engine: Engine | None = None
    ) -> None:
        self.engine = engine or _engine(settings)
        self._writing = self.engine.execution_options(stone_writes=True)
        self._readers = self._still = self.engine  # SQLite reads always see the state at the first statement (WAL)
        if not self.is_sqlite:
            self._readers = self.engine.execution_options(postgresql_readonly=True)
            self._still = self._readers.execution_options(isolation_level=SNAPSHOT)
        self._alone = self.engine if self.is_sqlite else self.engine.execution_options(isolation_level=EACH_ALONE)
        self._wake_up = wake_up
        self.ballast: Ballast | None = None
        """The file to delete on a full disk; None if this process must not delete it or writes nothing here."""

    @property
    def is_sqlite(self) -> bool:
        return self.engine.dialect.name == "sqlite"

    @contextmanager
    def transaction(self) -> Iterator[Session]:
        """Yield a session; commit at the end, then send the wake-ups it noted; roll back on any exception."""
        with Session(self._writing, expire_on_commit=False) as session:
            with self._with_ballast(), session.begin():
                yield session
            for queue, times in session.info.pop(WAKE_UPS, {}).items():
                if times:
                    self._wake_up(queue, times)

    @contextmanager
    def _with_ballast(self) -> Iterator[None]:
        """Delete the ballast before a transaction if space is low, and after a transaction that found no space."""
        if self.ballast is None:
            yield
            return
        self.ballast.give_up_if_low()
        try:
            yield
        except OperationalError as error:
            if is_full(error):
                self.ballast.give_up()
            raise

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """Yield a session whose changes are never written."""
        with _reading_on(self._readers) as session:
            yield session

    @contextmanager
    def lookups(self) -> Iterator[Session]:
        """As `reading`, without a transaction on PostgreSQL, which saves waiting for its start and end.

        Each statement sees all committed data, as in `reading`. A write would take effect immediately, so the session
        refuses to write rows.
        """
        with _LookupSession(self._alone, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def snapshot(self) -> Iterator[Session]:
        """As `reading`; all statements see the database at the time of the first."""
        with _reading_on(self._still) as session:
            yield session

    def close(self) -> None:
        self.engine.dispose()


class _LookupSession(Session):
    """Raises `invalid_request` instead of writing a row."""

    def flush(self, objects: Sequence[Any] | None = None) -> None:
        if self.new or self.dirty or self.deleted:
            raise InvalidRequestError("rows were changed in a read-only session")
        super().flush(objects)


def wake_up_after_commit(session: Session, queue: str, times: int = 1) -> None:
    """Note that `times` jobs of `queue` became ready in this transaction.

    A negative number of jobs were taken without a wake-up.
    """
    wake_ups = session.info.setdefault(WAKE_UPS, {})
    wake_ups[queue] = wake_ups.get(queue, 0) + times


@contextmanager
def _reading_on(engine: Engine) -> Iterator[Session]:
    with Session(engine, expire_on_commit=False) as session:
        yield session
        if engine.dialect.name != "sqlite":
            session.expunge_all()  # changes are not written
            with suppress(SQLAlchemyError):  # the data are read; the next user of the connection detects the loss
                session.commit()


def _engine(settings: Settings) -> Engine:
    url = make_url(settings.database_url)
    kept = settings.database.pool_size
    pool: dict[str, Any] = {"pool_size": kept, "max_overflow": most_connections(kept) - kept}
    if url.get_backend_name() == "sqlite":
        Path(url.database or "").parent.mkdir(parents=True, exist_ok=True)
        waits = {"timeout": settings.database.busy_timeout_s}
        return sqlite_engine(create_engine(url, connect_args=waits, hide_parameters=True, **pool))
    password = settings.database.password.get_secret_value() or url.password
    url = url.set(drivername="postgresql+psycopg", password=password)
    # Values may be secrets, so errors and logs show statements without parameters.
    engine = create_engine(url, connect_args={"connect_timeout": CONNECT_S}, hide_parameters=True, **pool)
    event.listen(engine, "checkout", _refuse_lost)
    return engine


def sqlite_engine(engine: Engine) -> Engine:
    """Return the engine, with its connections and the start of its transactions set up for `Database`."""
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _refuse_lost(connection: Any, _record: object, _pooled: object) -> None:
    """Raise `InvalidatePoolError` if the server has closed the connection; the pool then opens another one."""
    if connection.closed or (has_news(connection.fileno()) and not _answers(connection)):
        raise InvalidatePoolError


def has_news(descriptor: int) -> bool:
    """Return whether a socket has data to read, or is closed."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(0))


def _answers(connection: Any) -> bool:
    """Ping the server, because the unread data may be a notice."""
    try:
        connection.execute("")
        connection.rollback()
    except connection.OperationalError:
        return False
    return True


def _prepare_sqlite(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # STONE sends BEGIN itself; the driver's own comes too late for a write lock
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get("stone_writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


# Connections of a process to the database: an API process has as many connections as threads that may hold one. A
# thread holds at most one connection, so every thread gets one. With more threads the last would wait until the pool's
# timeout and then be refused.


MORE_REQUESTS = 20
"""Threads for requests beyond the permanently open connections (`STONE_DATABASE__POOL_SIZE`)."""
ROW_READERS = 8
"""Threads that serve lists (`api/row_readers.py`): while one runs Python, the others may wait for the database."""
UPLOADS = 16
"""Threads that receive uploads (`api/tus/body_stream.py`)."""
ALONE = 3
"""Dedicated threads: event streams, the probe of the database, counts."""


def request_threads(pool_size: int) -> int:
    """Return the number of threads for requests without dedicated threads."""
    return pool_size + MORE_REQUESTS


def most_connections(pool_size: int) -> int:
    """Return the maximum number of open connections of a process, including the permanent `pool_size`."""
    return request_threads(pool_size) + ROW_READERS + UPLOADS + ALONE
