"""The schema of a database, read without SQLite to decide whether SQLite may open it.

**Conventions.** SQLite parses every line of the schema and evaluates computed columns. A recorder's schema is a few
plain tables, so everything else in the tables to read is refused here, before SQLite opens the file. Other objects
(views, triggers, other tables) are never touched.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from stone_recordings.bags.db3.pages import INTERIOR, LEAF, Cell, Db3Pages
from stone_recordings.bags.db3.records import integer, layout_of, text
from stone_recordings.bags.errors import database_refused

MOST_OBJECTS = 200
MOST_SQL_BYTES = 64 * 1024
MOST_SCHEMA_PAGES = 4096
READ_TABLES: dict[str, tuple[str, ...]] = {
    "topics": ("name", "type", "serialization_format"),
    "messages": ("topic_id", "timestamp", "data"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}
# Columns with types, keys and NOT NULL; no CHECK, no DEFAULT (…), no computed columns, no other module.
PLAIN_TABLE = re.compile(
    r"""CREATE\s+TABLE\s+(?:IF\s+NOT\s+EXISTS\s+)?["'`\[]?(\w+)["'`\]]?\s*\([\w\s,"`\[\]]*\)\s*;?\s*""",
    re.ASCII | re.IGNORECASE,
)
COMPUTING = re.compile(r"\b(?:CHECK|GENERATED|AS|DEFAULT|COLLATE|WITHOUT|REFERENCES)\b", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True)
class Db3Table:
    name: str
    root_page: int


class DamagedSchemaError(Exception):
    """The pages of the schema cannot be read; the tables may still be there."""


def tables_of(pages: Db3Pages, name: str) -> dict[str, Db3Table]:
    """Return the tables that hold a recording.

    Raises: `BAG-018` (not a rosbag2 schema), DamagedSchemaError.
    """
    tables: dict[str, Db3Table] = {}
    for number, cell in enumerate(_schema_cells(pages)):
        if number >= MOST_OBJECTS:
            raise database_refused(name, f"its schema has more than {MOST_OBJECTS} entries, a recorder's has ten")
        kind, object_name, root_page, sql = _entry(pages, cell, name)
        if object_name in READ_TABLES:
            _check_plain(kind, object_name, sql, name)
            tables[object_name] = Db3Table(object_name, root_page)
    if missing := [table for table in ("topics", "messages") if table not in tables]:
        raise database_refused(name, f"it has no table {missing[0]!r}; another program's database?")
    return tables


def leaves(pages: Db3Pages, root: int, seen: bytearray) -> Iterator[int]:
    """Leaf pages under `root` in order of their keys, each once; `seen` (a byte a page) is shared between trees."""
    stack = [root]
    while stack:
        number = stack.pop()
        if not 0 < number <= pages.count or seen[number]:
            continue
        seen[number] = 1
        kind = pages.kind(number)
        if kind == LEAF:
            yield number
        elif kind == INTERIOR:
            stack.extend(reversed(list(pages.children(number))))


def _schema_cells(pages: Db3Pages) -> Iterator[Cell]:
    if pages.kind(1) not in (LEAF, INTERIOR):
        raise DamagedSchemaError
    for count, number in enumerate(leaves(pages, 1, bytearray(pages.count + 1))):
        if count > MOST_SCHEMA_PAGES:
            raise DamagedSchemaError
        yield from pages.cells(number)


def _entry(pages: Db3Pages, cell: Cell, name: str) -> tuple[str, str, int, str]:
    """Kind, name, root page and SQL of one line of the schema."""
    if cell.payload_bytes > MOST_SQL_BYTES:
        raise database_refused(name, f"a line of its schema has {cell.payload_bytes} bytes")
    payload = pages.payload(cell)
    layout = None if payload is None else layout_of(payload, cell.payload_bytes)
    if payload is None or layout is None or len(layout.types) < 5 or not (layout.is_text(0) and layout.is_text(1)):
        raise DamagedSchemaError
    kind, object_name = (text(payload, layout, column, pages.encoding) for column in (0, 1))
    root_page = integer(payload, layout, 3) if layout.is_integer(3) else 0
    sql = text(payload, layout, 4, pages.encoding) if layout.is_text(4) else ""
    return kind, object_name.lower(), root_page, sql


def _check_plain(kind: str, object_name: str, sql: str, name: str) -> None:
    if kind != "table":
        raise database_refused(name, f"its {object_name!r} is a {kind}, not a table")
    plain = PLAIN_TABLE.fullmatch(sql)
    has_columns = set(READ_TABLES[object_name]) <= set(re.findall(r"\w+", sql.lower()))
    if plain is None or plain[1].lower() != object_name or COMPUTING.search(sql) or not has_columns:
        shown = " ".join(sql.split())[:120]
        raise database_refused(name, f"its table {object_name!r} is not a recorder's: {shown}")
