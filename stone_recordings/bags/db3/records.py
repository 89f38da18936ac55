"""One row of a SQLite table: the offsets of its columns, and their values.

**Conventions.** A serial type is as in the file format, section 2.1: 0 NULL, 1–6 integers, 7 a double, 8 and 9 the
constants 0 and 1. Even types from 12 on are blobs, odd types from 13 on texts. A record that contradicts its length is
None.
"""

from dataclasses import dataclass

from stone_recordings.bags.db3.pages import read_varint

INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
MOST_COLUMNS = 32
Value = int | str | bytes | float | None


@dataclass(frozen=True, slots=True)
class Db3RecordLayout:
    """Serial types and the start of each column, in bytes from the start of the payload."""

    types: tuple[int, ...]
    at: tuple[int, ...]

    def size_bytes(self, column: int) -> int:
        return _size_bytes(self.types[column])

    def is_blob(self, column: int) -> bool:
        return self.types[column] >= 12 and self.types[column] % 2 == 0

    def is_text(self, column: int) -> bool:
        return self.types[column] >= 13 and self.types[column] % 2 == 1

    def is_integer(self, column: int) -> bool:
        return self.types[column] in INTEGER_BYTES


def layout_of(head: memoryview | bytes, payload_bytes: int) -> Db3RecordLayout | None:
    """Return the layout of a payload whose first bytes are `head`; None if its columns do not fill `payload_bytes`
    exactly.
    """
    header_bytes, at = read_varint(head, 0)
    if not at <= header_bytes <= len(head):
        return None
    types: list[int] = []
    while at < header_bytes:
        serial, at = read_varint(head, at)
        types.append(serial)
        if len(types) > MOST_COLUMNS or serial in (10, 11):
            return None
    places, stop = [], header_bytes
    for serial in types:
        places.append(stop)
        stop += _size_bytes(serial)
    return Db3RecordLayout(tuple(types), tuple(places)) if at == header_bytes and stop == payload_bytes else None


def integer(payload: memoryview | bytes, layout: Db3RecordLayout, column: int) -> int:
    """Return the value of an integer column; 0 if the payload ends before it."""
    serial, at = layout.types[column], layout.at[column]
    if serial in (8, 9):
        return serial - 8
    return int.from_bytes(payload[at : at + INTEGER_BYTES[serial]], "big", signed=True)


def text(payload: bytes, layout: Db3RecordLayout, column: int, encoding: str) -> str:
    """Return the value of a text column; invalid text in `encoding` is replaced."""
    at = layout.at[column]
    return payload[at : at + layout.size_bytes(column)].decode(encoding, errors="replace")


def _size_bytes(serial: int) -> int:
    if serial >= 12:
        return (serial - 12) // 2
    return 8 if serial == 7 else INTEGER_BYTES.get(serial, 0)
