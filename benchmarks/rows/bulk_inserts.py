"""Bulk generation of rows inside PostgreSQL; omitted columns take their defaults.

**Conventions.** Synthetic rows refer to each other by number. `hex_id(kind, n)` is the id of the n-th row of a kind
(ids sort by n, like real ones by age); `hex_sha(kind, n)` is a uniformly distributed sha256, like real contents. For
speed, foreign keys are not checked and plain indexes are created afterwards.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import md5
from typing import Any

from sqlalchemy import JSON, Column, Connection, text

from services.runtime.orm import Base
from services.runtime.orm.base import now_ns

FUNCTIONS = (
    """CREATE FUNCTION hex_id(kind int, n bigint) RETURNS text LANGUAGE sql IMMUTABLE PARALLEL SAFE AS
    $$ SELECT lpad(to_hex(n * 32 + kind), 16, '0') || substr(md5(kind::text || ':' || n::text), 1, 16) $$""",
    """CREATE FUNCTION hex_sha(kind int, n bigint) RETURNS text LANGUAGE sql IMMUTABLE PARALLEL SAFE AS
    $$ SELECT encode(sha256((kind::text || ':' || n::text)::bytea), 'hex') $$""",
)


def hex_id(kind: int, number: int) -> str:
    """Return the id, equal to the function of that name in the database."""
    return f"{number * 32 + kind:016x}{md5(f'{kind}:{number}'.encode()).hexdigest()[:16]}"


def prepare(connection: Connection) -> None:
    """Create the functions, and disable foreign keys for this session."""
    for function in FUNCTIONS:
        connection.execute(text(function))
    connection.execute(text("SET session_replication_role = replica"))


def insert_rows(connection: Connection, name: str, source: str, given: Mapping[str, str], order: str = "") -> None:
    """Insert rows of table `name` from `source` (the text after FROM): each column as in `given` (SQL), else its
    default.
    """
    table = Base.metadata.tables[name]
    unknown = set(given) - set(table.columns.keys())
    if unknown:
        raise ValueError(f"table {name} has no columns {sorted(unknown)}; was the schema changed?")
    values = [given.get(column.name) or _default(column) for column in table.columns]
    columns = ", ".join(f'"{column.name}"' for column in table.columns)
    ordered = f" ORDER BY {order}" if order else ""
    connection.execute(text(f"INSERT INTO {name} ({columns}) SELECT {', '.join(values)} FROM {source}{ordered}"))


def numbers(count: int) -> str:
    """Return the text after FROM for n in 1 … count."""
    return f"generate_series(1::bigint, {count}) AS n"


@contextmanager
def without_indexes(connection: Connection, tables: tuple[str, ...]) -> Iterator[None]:
    """Drop all indexes except primary keys for the block; they are created again at the end, in memory and at once."""
    indexes = connection.execute(
        text(
            """SELECT indexname, indexdef, conname, tablename FROM pg_indexes
            LEFT JOIN pg_constraint ON conname = indexname AND contype IN ('p', 'u')
            WHERE tablename = ANY(:tables) AND (contype IS NULL OR contype <> 'p')"""
        ),
        {"tables": list(tables)},
    ).all()
    for index, _made, constraint, table in indexes:
        gone = f"ALTER TABLE {table} DROP CONSTRAINT {constraint}" if constraint else f"DROP INDEX {index}"
        connection.execute(text(gone))
    yield
    for index, made, constraint, table in indexes:
        connection.execute(text(made))
        if constraint:
            connection.execute(text(f"ALTER TABLE {table} ADD CONSTRAINT {constraint} UNIQUE USING INDEX {index}"))


def analyse(connection: Connection) -> None:
    """Run a server's routine maintenance: statistics, and pages marked as visible to all."""
    connection.execute(text("VACUUM (ANALYZE)"))


def _default(column: Column[Any]) -> str:
    if column.nullable:
        return "NULL"
    default = getattr(column.default, "arg", None)
    if callable(default):
        default = default(None)
    elif default is None and not isinstance(column.type, JSON):
        default = {str: "", int: now_ns(), bool: False, bytes: b""}.get(column.type.python_type)
    elif default is None:
        default = {}
    return _literal(default, column)


def _literal(value: object, column: Column[Any]) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, dict | list):
        return f"'{json.dumps(value)}'::json"
    if isinstance(value, bytes):
        return "''::bytea"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    raise ValueError(f"no default for {column}; state its value")
