"""Rows of a sound database through SQLite, opened so that the file can neither change nor be misused.

**Conventions.** Read-only; only the three tables of a recording, no view, trigger, function or file beyond them; no
memory map (SQLite's own advice for hostile files). Payloads are read by rowid; their heads through blob handles, which
touch the first pages of a message and no others. Source: sqlite.org/security.html.
"""

import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from urllib.parse import quote

import numpy as np

from stone.findings import Finding
from stone_recordings.bags.db3.rows import Db3Topic, RowIndex
from stone_recordings.bags.errors import database_refused
from stone_recordings.bags.magic import has_wal
from stone_recordings.bags.private_folder import PrivateFolder
from stone_recordings.bags.unpacked_messages import MESSAGE_LIMIT_BYTES

# Read-only access to a SQLite database: in place, or as a private copy with its journal. A sound database is opened in
# place, as immutable. Files left by a crash are applied in a private folder: a write-ahead log (`-wal`) to the same
# bytes under another name, a rollback journal (`-journal`) to a copy. A journal that names other files is never
# applied: SQLite would delete them.


JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
JOURNAL_BYTES = 512  # the smallest journal is one sector


@dataclass(frozen=True)
class Db3Location:
    """Opens `path`; `is_clean` if nothing lay beside it, so that it may be opened as immutable."""

    path: Path
    is_clean: bool
    folder: PrivateFolder | None
    findings: tuple[Finding, ...]

    @property
    def wal(self) -> Path | None:
        wal = _beside(self.path, "-wal")
        return wal if wal.is_file() and wal.stat().st_size else None

    def close(self) -> None:
        if self.folder is not None:
            self.folder.close()


def db3_location_of(path: Path) -> Db3Location:
    """Return the location. Raises: `BAG-018`, NoRoomError."""
    journal = _beside(path, "-journal")
    if has_wal(path):
        return _with_wal(path)
    if _is_hot(journal):
        return _with_journal(path, journal)
    return Db3Location(path, is_clean=True, folder=None, findings=())


def _with_wal(path: Path) -> Db3Location:
    wal, folder = _beside(path, "-wal"), PrivateFolder()
    try:
        placed = folder.link_or_copy(path)
        folder.copy(wal)
    except BaseException:
        folder.close()
        raise
    message = f"{path.name} was not closed: the {wal.stat().st_size} bytes of its -wal file are read with it."
    return Db3Location(
        placed, is_clean=False, folder=folder, findings=(Finding("BAG-029", "warning", path.name, message),)
    )


def _with_journal(path: Path, journal: Path) -> Db3Location:
    if _names_other_files(journal):
        raise database_refused(path.name, "the -journal beside it names other files, no recorder's does")
    folder = PrivateFolder()
    try:
        placed = folder.copy(path)
        folder.copy(journal)
    except BaseException:
        folder.close()
        raise
    message = f"{path.name} was not closed: the transaction that its -journal file holds was undone in a copy."
    return Db3Location(
        placed, is_clean=False, folder=folder, findings=(Finding("BAG-029", "warning", path.name, message),)
    )


def _names_other_files(journal: Path) -> bool:
    """Return whether the file ends with this mark, which follows the name of a super-journal (pager.c,
    readSuperJournal).
    """
    with journal.open("rb") as file:
        file.seek(-len(JOURNAL_MAGIC), os.SEEK_END)
        return file.read() == JOURNAL_MAGIC


def _is_hot(journal: Path) -> bool:
    """Return whether it holds a transaction: a finished one is emptied, cut or overwritten with zeros."""
    if not journal.is_file() or journal.stat().st_size < JOURNAL_BYTES:
        return False
    with journal.open("rb") as file:
        return file.read(len(JOURNAL_MAGIC)) == JOURNAL_MAGIC


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f"{path.name}{suffix}")


READ_TABLES = frozenset({"sqlite_master", "topics", "messages", "message_definitions"})
FUNCTIONS = frozenset({"length", "typeof", "substr"})
PRAGMAS = frozenset({"quick_check"})
SQL_LIMIT_BYTES = 128 * 1024
MOST_TOPICS = 10_000
DEFINITION_LIMIT_BYTES = 2**20
BATCH_ROWS = 65_536
# Up to this size every page is checked on opening; in a larger file only the pages that locate messages.
CHECKED_BYTES = 64 * 2**20
INDEX_QUERY = """
SELECT rowid, CASE WHEN sound THEN topic_id ELSE -1 END, CASE WHEN sound THEN timestamp ELSE 0 END,
       CASE WHEN sound THEN length(data) ELSE -1 END
FROM (SELECT rowid, topic_id, timestamp, data,
             typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob' AS sound
      FROM messages NOT INDEXED) ORDER BY rowid"""


class DamagedDatabaseError(Exception):
    """SQLite reports that the file is malformed, in its own sentence."""


class SqlRows:
    """Rows of `place`, as `stone_recordings.bags.db3.rows`; `name` is the file's name in messages."""

    def __init__(self, place: Db3Location, name: str) -> None:
        self._place, self._name = place, name
        self.findings: tuple[Finding, ...] = ()
        self._connection: sqlite3.Connection | None = None
        with self._reading() as connection:
            if _bytes_of(place) <= CHECKED_BYTES:
                _check(connection)
            self.topics = _topics(connection, name)
            self.definitions = _definitions(connection)
            self.index = _index(connection, _bytes_of(place))

    def data(self, rowid: int) -> bytes:
        """Read by a blob handle, which copies once, unlike a query, which copies twice."""
        with self._reading() as connection, connection.blobopen("messages", "data", rowid, readonly=True) as blob:
            return blob.read()

    def several(self, rowids: Sequence[int]) -> dict[int, bytes]:
        query = f"SELECT rowid, data FROM messages WHERE rowid IN ({', '.join('?' * len(rowids))})"
        with self._reading() as connection:
            return dict(connection.execute(query, rowids))

    def head(self, rowid: int, size_bytes: int) -> bytes:
        with self._reading() as connection, connection.blobopen("messages", "data", rowid, readonly=True) as blob:
            return blob.read(size_bytes)

    def release(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        self.release()
        self._place.close()

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Yield the connection, opened again after `release`; SQLite's errors become DamagedDatabaseError."""
        try:
            if self._connection is None:
                self._connection = _connected(self._place)
            yield self._connection
        except (sqlite3.Error, UnicodeError) as error:  # its sentences quote names that may be no text
            self.release()
            raise DamagedDatabaseError(str(error)) from None


def _connected(database: Db3Location) -> sqlite3.Connection:
    mode = "mode=ro&immutable=1" if database.is_clean else "mode=rw" if database.wal is None else "mode=ro"
    location = f"file:{quote(str(database.path.resolve()))}?{mode}"  # a rollback needs rw
    connection = sqlite3.connect(location, uri=True, check_same_thread=False, isolation_level=None)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MESSAGE_LIMIT_BYTES)
    connection.setlimit(sqlite3.SQLITE_LIMIT_SQL_LENGTH, SQL_LIMIT_BYTES)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "mmap_size = 0", "query_only = ON"):
        connection.execute(f"PRAGMA {pragma}")
    connection.text_factory = lambda text: text.decode(errors="replace")
    connection.set_authorizer(_allowed)
    return connection


def _allowed(action: int, first: str | None, second: str | None, _database: str | None, inner: str | None) -> int:
    """Allow only this module's own statements, and nothing on behalf of a view or trigger (`inner`)."""
    is_ours = inner is None and (
        action == sqlite3.SQLITE_SELECT
        or (action == sqlite3.SQLITE_READ and (first or "").lower() in READ_TABLES | {"sqlite_schema", ""})
        or (action == sqlite3.SQLITE_FUNCTION and (second or "").lower() in FUNCTIONS)
        or (action == sqlite3.SQLITE_PRAGMA and (first or "").lower() in PRAGMAS)
    )
    return sqlite3.SQLITE_OK if is_ours else sqlite3.SQLITE_DENY


def _bytes_of(location: Db3Location) -> int:
    return location.path.stat().st_size + (location.wal.stat().st_size if location.wal else 0)


def _check(connection: sqlite3.Connection) -> None:
    """Check every page of the messages, also those that an index of them does not need."""
    problems = [str(row[0]) for row in connection.execute("PRAGMA quick_check('messages')").fetchmany(4)]
    if problems != ["ok"]:
        raise DamagedDatabaseError(problems[0] if problems else "no answer to quick_check")


def _topics(connection: sqlite3.Connection, name: str) -> tuple[Db3Topic, ...]:
    query = """SELECT rowid, name, type, serialization_format FROM topics
               WHERE typeof(name) = 'text' AND typeof(type) = 'text' AND typeof(serialization_format) = 'text'"""
    rows = connection.execute(query).fetchmany(MOST_TOPICS + 1)
    if len(rows) > MOST_TOPICS:
        raise database_refused(name, f"it has more than {MOST_TOPICS} topics")
    return tuple(Db3Topic(*row) for row in rows)


def _definitions(connection: sqlite3.Connection) -> dict[str, str]:
    """Return the definitions by type; schema version 4 introduced their table, older databases have none."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name = 'message_definitions'"
    if connection.execute(query).fetchone() is None:
        return {}
    query = """SELECT topic_type, encoded_message_definition FROM message_definitions
               WHERE typeof(topic_type) = 'text' AND typeof(encoded_message_definition) = 'text'
               AND length(encoded_message_definition) <= ?"""
    return dict(connection.execute(query, (DEFINITION_LIMIT_BYTES,)).fetchmany(MOST_TOPICS))


def _index(connection: sqlite3.Connection, file_bytes: int) -> RowIndex:
    """Return the index. Raises DamagedDatabaseError if rowids do not ascend: a tree with two paths to one page never
    ends.
    """
    cursor, parts, last = connection.execute(INDEX_QUERY), [np.zeros((0, 4), np.int64)], -(2**63) - 1
    while rows := cursor.fetchmany(BATCH_ROWS):
        part = np.fromiter(chain.from_iterable(rows), np.int64, 4 * len(rows)).reshape(-1, 4)
        if part[0, 0] <= last or (np.diff(part[:, 0]) <= 0).any():
            raise DamagedDatabaseError("its rows are not in order")
        last = int(part[-1, 0])
        parts.append(part)
    table = np.concatenate(parts)
    is_sound = (table[:, 2] >= 0) & (table[:, 3] >= 0) & (table[:, 3] <= file_bytes)
    rowid, topic_id, time_ns, size_bytes = np.ascontiguousarray(table[is_sound].T)
    return RowIndex(rowid, topic_id, time_ns, size_bytes, int((~is_sound).sum()))
