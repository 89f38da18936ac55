"""Salvage of a damaged rosbag2 database: collects message rows by walking all of its pages.

**Conventions.** Topics are (NULL, name, type, format, …), definitions (NULL, type, encoding, text, …), messages (NULL,
topic id, log time, blob). Every page is visited once, regardless of the trees.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from stone_recordings.bags.db3.objects import DamagedSchemaError, leaves, tables_of
from stone_recordings.bags.db3.pages import LEAF, Cell, Db3Pages
from stone_recordings.bags.db3.records import Db3RecordLayout, integer, layout_of, text
from stone_recordings.bags.db3.rows import Db3Topic

TOPIC_ID, TIMESTAMP, DATA = 1, 2, 3
TEXT_LIMIT_BYTES = 2**20
SCHEMA_ENCODINGS = ("ros2msg", "ros2idl")


@dataclass
class Db3CollectedRows:
    """`messages` holds (rowid, topic id, log time, size, page, slot) of every row whose payload is whole."""

    pages: Db3Pages
    used: bytearray
    topics: dict[int, Db3Topic] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[int, ...]] = field(default_factory=list)

    def take_text(self, _number: int, _slot: int, cell: Cell) -> None:
        """Take a topic or a definition: the column with "ros2msg" distinguishes them."""
        payload = self.pages.payload(cell) if cell.payload_bytes <= TEXT_LIMIT_BYTES else None
        layout = None if payload is None else layout_of(payload, cell.payload_bytes)
        if payload is None or layout is None or not _has_texts(layout):
            return
        first, second, third = (text(payload, layout, column, self.pages.encoding) for column in (1, 2, 3))
        if second in SCHEMA_ENCODINGS:
            self.definitions.setdefault(first, third)
        else:
            self.topics.setdefault(cell.rowid, Db3Topic(cell.rowid, first, second, third))

    def take_message(self, number: int, slot: int, cell: Cell) -> None:
        layout = message_layout(cell)
        if layout is None or self.pages.overflow(cell, cell.payload_bytes, self.used) is None:
            return
        topic_id, time_ns = (integer(cell.local, layout, column) for column in (TOPIC_ID, TIMESTAMP))
        if time_ns >= 0:
            self.messages.append((cell.rowid, topic_id, time_ns, layout.size_bytes(DATA), number, slot))


def collect(pages: Db3Pages, name: str) -> Db3CollectedRows:
    """Collect every readable row. Raises `BAG-018` for a schema that is no recorder's."""
    rows = Db3CollectedRows(pages, bytearray(pages.count + 1))
    with suppress(DamagedSchemaError):
        tables = tables_of(pages, name)
        for table, root_page in ((table, tables[table].root_page) for table in sorted(tables)):
            take = rows.take_message if table == "messages" else rows.take_text
            for number in leaves(pages, root_page, rows.used):
                _take_all(pages, number, take)
    for number in range(2, pages.count + 1):
        if not rows.used[number] and pages.kind(number) == LEAF:
            _take_orphan(rows, number)
    return rows


def message_layout(cell: Cell) -> Db3RecordLayout | None:
    """Return the layout; None if the row is no message."""
    layout = layout_of(cell.local, cell.payload_bytes)
    if layout is None or len(layout.types) != 4 or not layout.is_blob(DATA):
        return None
    return layout if layout.is_integer(TOPIC_ID) and layout.is_integer(TIMESTAMP) else None


def _take_all(pages: Db3Pages, number: int, take: Callable[[int, int, Cell], None]) -> None:
    for slot, cell in enumerate(pages.cells(number)):
        take(number, slot, cell)


def _take_orphan(rows: Db3CollectedRows, number: int) -> None:
    """Take a leaf without a parent: its rows are all messages, or all topics or definitions, or the leaf is foreign."""
    cells = list(rows.pages.cells(number))
    layouts = [layout_of(cell.local, cell.payload_bytes) for cell in cells]
    rows.used[number] = 1
    if cells and all(message_layout(cell) is not None for cell in cells):
        _take_all(rows.pages, number, rows.take_message)
    elif cells and all(layout is not None and _has_texts(layout) for layout in layouts):
        _take_all(rows.pages, number, rows.take_text)


def _has_texts(layout: Db3RecordLayout) -> bool:
    return 4 <= len(layout.types) <= 6 and layout.types[0] == 0 and all(layout.is_text(column) for column in (1, 2, 3))
