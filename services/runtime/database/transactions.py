"""Database transactions on SQLite (WAL) or PostgreSQL, and the wake-ups sent after their commit.

**Conventions.** `transaction()` is for writing: on SQLite it takes the write lock at BEGIN, so two writers wait for
each other instead of failing half-way; it commits at the end or rolls back whole. `reading()` is for reading and writes
nothing; nor does `snapshot()`, in which later statements see nothing newer than the first, nor `lookups()`, for what is
asked most often. None is held while anything slow is done. What `wake_up_after_commit` notes is dropped with a
rollback.
One `Database` belongs to one process: a forked child makes its own (`services/runtime/platform.py`).

On PostgreSQL what reads is a READ ONLY transaction and ends with COMMIT: at a ROLLBACK psycopg 3.3 gives up all that is
prepared on the connection, so that each statement after it would be parsed and planned anew.

A server that ends says so on its connections before it closes them. So a connection on which nothing has come since it
was used last is taken as it is, and only one that has something to read is asked whether it lives: a look at the
socket costs the server nothing, a question would be a transaction before each transaction.
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
SNAPSHOT = "REPEATABLE READ"  # of PostgreSQL: nothing newer than the first statement is seen
EACH_ALONE = "AUTOCOMMIT"  # of PostgreSQL: every statement is a transaction


class Database:
    """`with database.transaction() as session: …`; `wake_up(queue, times)` is called after the commit."""

    def __init__(
        self, settings: Settings, wake_up: WakeUp = lambda queue, times: None, engine: Engine | None = None
    ) -> None:
        self.engine = engine or _engine(settings)
        self._writing = self.engine.execution_options(stone_writes=True)
        self._readers = self._still = self.engine  # what SQLite reads is as it was at the first statement anyway (WAL)
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
            with self._ballasted(), session.begin():
                yield session
            for queue, times in session.info.pop(WAKE_UPS, {}).items():
                if times:
                    self._wake_up(queue, times)

    @contextmanager
    def _ballasted(self) -> Iterator[None]:
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
        """As `reading`, without a transaction on PostgreSQL: its beginning and its end would be waited for too.

        Each statement sees what is committed by then, as it does in `reading`. What it wrote would be there at once, so
        it refuses to write rows.
        """
        with _LookupSession(self._alone, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def snapshot(self) -> Iterator[Session]:
        """As `reading`; all its statements see the database as it was at the first of them."""
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
    """Note that `times` jobs of `queue` became ready in this transaction; less than none: were taken without one."""
    wake_ups = session.info.setdefault(WAKE_UPS, {})
    wake_ups[queue] = wake_ups.get(queue, 0) + times


@contextmanager
def _reading_on(engine: Engine) -> Iterator[Session]:
    with Session(engine, expire_on_commit=False) as session:
        yield session
        if engine.dialect.name != "sqlite":
            session.expunge_all()  # what was changed is not written
            with suppress(SQLAlchemyError):  # read is read: whoever takes the connection next sees that it is lost
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
    # What is written may be a secret, so errors and logs show statements without it.
    engine = create_engine(url, connect_args={"connect_timeout": CONNECT_S}, hide_parameters=True, **pool)
    event.listen(engine, "checkout", _refuse_lost)
    return engine


def sqlite_engine(engine: Engine) -> Engine:
    """Return the engine, with its connections and the start of its transactions set up for `Database`."""
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _refuse_lost(connection: Any, _record: object, _pooled: object) -> None:
    """Raises `InvalidatePoolError` where the server has closed the connection: the pool opens another then."""
    if connection.closed or (has_news(connection.fileno()) and not _answers(connection)):
        raise InvalidatePoolError


def has_news(descriptor: int) -> bool:
    """Whether there is anything to read on a socket, its end included."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(0))


def _answers(connection: Any) -> bool:
    """What came may be a notice: the server is asked."""
    try:
        connection.execute("")
        connection.rollback()
    except connection.OperationalError:
        return False
    return True


def _prepare_sqlite(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # we say BEGIN ourselves; the driver's own comes too late for a write lock
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get("stone_writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


# Connections of a process to the database: an API process has no more threads that may hold one than connections.
#
# **Conventions.** A thread holds one at most. Whoever is given a thread is given a connection too: with more threads
# the last of them would wait for it as long as the pool lets them, and then be refused.


MORE_REQUESTS = 20
"""Threads that answer requests beyond the connections that are kept open (`STONE_DATABASE__POOL_SIZE`)."""
ROW_READERS = 8
"""Threads that answer lists (`api/row_readers.py`): while one runs Python, the others may wait for the database."""
UPLOADS = 16
"""Threads that take uploads (`api/tus/body_stream.py`)."""
ALONE = 3
"""Threads with a purpose of their own: event streams, the probe of the database, counts."""


def request_threads(pool_size: int) -> int:
    """The number of threads that answer whatever has none of its own."""
    return pool_size + MORE_REQUESTS


def most_connections(pool_size: int) -> int:
    """How many a process has open at most, of which `pool_size` are kept."""
    return request_threads(pool_size) + ROW_READERS + UPLOADS + ALONE
