"""Dump and restore of all database tables in one snapshot, between SQLite and PostgreSQL in any direction.

**Conventions.** PostgreSQL reads and writes the files itself (COPY), in a REPEATABLE READ transaction; SQLite's WAL
gives a reader the state of its first statement. The backup contains the schema's revision instead of the schema:
Alembic creates it, the rows follow in the order of their references, then Alembic upgrades to this code's revision. All
of it is one transaction, so a database is restored completely or stays empty.
"""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import zstandard
from alembic import command
from alembic.runtime.migration import MigrationContext
from sqlalchemy import JSON, Boolean, Column, Connection, Float, Integer, LargeBinary, MetaData, String, Table, inspect

from services.runtime.backup.errors import DamagedBackupError
from services.runtime.backup.folder import PIECE_BYTES, sha256_of
from services.runtime.database.migrate import alembic_on, head_revision
from services.runtime.database.transactions import Database
from services.runtime.orm import Base
from stone.errors import Refused

# Rows as text, in the format of PostgreSQL's `COPY … (FORMAT text)`, read and written without PostgreSQL. One line per
# row, values separated by tabs, `\N` for null; backslash, tab and line ends within a value are escaped. Booleans are t
# and f, bytes `\x` and hex, JSON its stored text, character by character. Source: PostgreSQL documentation, COPY, "Text
# Format".


Kind = Literal["text", "integer", "float", "boolean", "json", "bytes"]

NULL = "\\N"
_ESCAPED = str.maketrans({"\\": "\\\\", "\t": "\\t", "\n": "\\n", "\r": "\\r"})
_SIGNS = {"t": "\t", "n": "\n", "r": "\r", "b": "\b", "f": "\f", "v": "\v", "\\": "\\"}
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_KINDS: tuple[tuple[type, Kind], ...] = (
    (Boolean, "boolean"),
    (JSON, "json"),
    (LargeBinary, "bytes"),
    (Integer, "integer"),
    (Float, "float"),
    (String, "text"),
)


def kind_of(column: Column[Any]) -> Kind:
    """Return the text format of the column's values."""
    return next(kind for type_, kind in _KINDS if isinstance(column.type, type_))


def line_of(row: Iterable[Any], kinds: Sequence[Kind]) -> str:
    """Return a row from SQLite's driver as a line."""
    return "\t".join(NULL if value is None else _WRITTEN[kind](value) for value, kind in zip(row, kinds, strict=True))


def row_of(line: str, kinds: Sequence[Kind]) -> list[Any]:
    """Return a line's row for SQLite's driver. Raises `ValueError` for an invalid line."""
    fields = line.split("\t")
    return [None if field == NULL else _READ[kind](_unescape(field)) for field, kind in zip(fields, kinds, strict=True)]


def lines_of(pieces: Iterable[bytes]) -> Iterator[str]:
    """Yield the lines of a file that arrives in pieces."""
    rest = b""
    for piece in pieces:
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            yield line.decode("utf-8")
    if rest:
        raise ValueError("the last line is incomplete")


def _unescape(field: str) -> str:
    return _ESCAPE.sub(lambda match: _SIGNS.get(match[1], match[1]), field) if "\\" in field else field


def _text(value: Any) -> str:
    return str(value).translate(_ESCAPED)


_WRITTEN: Mapping[Kind, Callable[[Any], str]] = {
    "text": _text,
    "json": _text,
    "integer": lambda value: str(int(value)),
    "float": lambda value: repr(float(value)),
    "boolean": lambda value: "t" if value else "f",
    "bytes": lambda value: "\\\\x" + bytes(value).hex(),
}
_READ: Mapping[Kind, Callable[[str], Any]] = {
    "text": str,
    "json": str,
    "integer": int,
    "float": float,
    "boolean": lambda field: int(field == "t"),
    "bytes": lambda field: bytes.fromhex(field.removeprefix("\\x")),
}


BATCH = 1000
TABLES = "tables"


@dataclass(frozen=True)
class ColumnFacts:
    name: str
    kind: Kind


@dataclass(frozen=True)
class TableFacts:
    """A written table; `sha256` is its file's."""

    name: str
    columns: tuple[ColumnFacts, ...]
    rows: int
    sha256: str

    @property
    def kinds(self) -> tuple[Kind, ...]:
        return tuple(column.kind for column in self.columns)


@contextmanager
def snapshot_of(database: Database) -> Iterator[Connection]:
    """Yield a connection that sees the current state of the database. Raises `schema_not_current`."""
    options = {} if database.is_sqlite else {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with database.engine.connect().execution_options(**options) as connection:
        stands = MigrationContext.configure(connection).get_current_revision()
        if stands != head_revision():
            raise Refused(
                "schema_not_current",
                f"the database is at revision {str(stands)!r}, but this version needs {head_revision()!r}; back up "
                "with the version that serves the database, or migrate first",
            )
        yield connection


def dump(connection: Connection, folder: Path, metadata: MetaData = Base.metadata) -> tuple[TableFacts, ...]:
    """Write every table into `folder/tables`, in the order of their references."""
    (folder / TABLES).mkdir()
    return tuple(_dump(connection, folder, table) for table in metadata.sorted_tables)


def dumped_rows(folder: Path, table: TableFacts, names: Sequence[str]) -> Iterator[list[Any]]:
    """Yield the named columns of a table's rows. Raises `DamagedBackupError`."""
    places = [[column.name for column in table.columns].index(name) for name in names]
    for line in _lines(_path(folder, table)):
        row = row_of(line, table.kinds)
        yield [row[index] for index in places]


def checked_tables(folder: Path, tables: Sequence[TableFacts]) -> None:
    """Raise `DamagedBackupError` if a file differs from what was written."""
    for table in tables:
        path = _path(folder, table)
        if not path.is_file() or sha256_of(path) != table.sha256:
            raise DamagedBackupError(path, "differs from the snapshot's record")


def load(connection: Connection, folder: Path, revision: str, tables: Sequence[TableFacts]) -> None:
    """Fill a database without tables, in the connection's transaction. Raises `DamagedBackupError`."""
    config = alembic_on(connection)
    command.upgrade(config, revision)
    known = inspect(connection)
    for table in tables:
        columns = {column["name"] for column in known.get_columns(table.name)}
        if unknown := [column.name for column in table.columns if column.name not in columns]:
            raise DamagedBackupError(
                _path(folder, table), f"has columns that are not in revision {revision}: {unknown}"
            )
        _load(connection, folder, table)
    command.upgrade(config, "head")


def _dump(connection: Connection, folder: Path, table: Table) -> TableFacts:
    columns = tuple(ColumnFacts(column.name, kind_of(column)) for column in table.columns)
    path, rows, hashed = folder / TABLES / f"{table.name}.zst", 0, hashlib.sha256()
    compressor = zstandard.ZstdCompressor(level=3, threads=1).compressobj()
    with path.open("xb") as file:
        for piece in _written(connection, TableFacts(table.name, columns, 0, "")):
            rows += piece.count(b"\n")
            packed = compressor.compress(piece)
            hashed.update(packed)
            file.write(packed)
        packed = compressor.flush()
        hashed.update(packed)
        file.write(packed)
    return TableFacts(table.name, columns, rows, hashed.hexdigest())


def _written(connection: Connection, table: TableFacts) -> Iterator[bytes]:
    """Yield the table's rows as text, in pieces."""
    names, target = _quoted(connection, table)
    if connection.dialect.name == "sqlite":
        rows = connection.exec_driver_sql(f"SELECT {names} FROM {target}")
        for batch in rows.partitions(BATCH):
            yield "".join(line_of(row, table.kinds) + "\n" for row in batch).encode("utf-8")
        return
    with _cursor(connection).copy(f"COPY (SELECT {names} FROM {target}) TO STDOUT") as copy:
        for piece in copy:
            yield bytes(piece)


def _load(connection: Connection, folder: Path, table: TableFacts) -> None:
    names, target = _quoted(connection, table)
    path = _path(folder, table)
    if connection.dialect.name != "sqlite":
        with _cursor(connection).copy(f"COPY {target} ({names}) FROM STDIN") as copy:
            for piece in _unpacked(path):
                copy.write(piece)
        return
    marks = ", ".join("?" * len(table.columns))
    for batch in _batches(path, table.kinds):
        connection.exec_driver_sql(f"INSERT INTO {target} ({names}) VALUES ({marks})", batch)


def _batches(path: Path, kinds: Sequence[Kind]) -> Iterator[list[tuple[Any, ...]]]:
    rows = (tuple(row_of(line, kinds)) for line in _lines(path))
    while batch := list(islice(rows, BATCH)):
        yield batch


def _lines(path: Path) -> Iterator[str]:
    try:
        yield from lines_of(_unpacked(path))
    except (ValueError, zstandard.ZstdError) as error:
        raise DamagedBackupError(path, f"cannot be read: {error}") from error


def _unpacked(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        yield from zstandard.ZstdDecompressor().read_to_iter(file, write_size=PIECE_BYTES)


def _path(folder: Path, table: TableFacts) -> Path:
    return folder / TABLES / f"{table.name}.zst"


def _quoted(connection: Connection, table: TableFacts) -> tuple[str, str]:
    quote = connection.dialect.identifier_preparer.quote_identifier
    return ", ".join(quote(column.name) for column in table.columns), quote(table.name)


def _cursor(connection: Connection) -> Any:
    """Return psycopg's own cursor, in the connection's transaction."""
    driver: Any = connection.connection.driver_connection
    return driver.cursor()
