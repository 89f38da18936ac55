"""Plain CDR as ROS 2 writes it: check, walk, and view many messages of one layout as numpy records.

**Conventions.** A payload is 4 bytes of encapsulation, then the body; alignment counts from the body's first byte.
Only little-endian plain CDR is read. A field is (name, kind): a numpy scalar code such as "f8", "9f8", "string", or
"count" for the length of a sequence whose elements follow in the list. Source: OMG DDSI-RTPS 2.5, 10; the walk
checks every length against the payload before it is used.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from services.ingest.errors import ByteOrderError, MessageLayoutError

HEAD_BYTES = 4
# rmw implementations pad a message to four bytes or do not: so many bytes may follow the last field.
PADDING_BYTES = 3
NS_PER_S = 1_000_000_000

Field = tuple[str, str]
Table = NDArray[np.void]
HEADER: tuple[Field, ...] = (("sec", "i4"), ("nanosec", "u4"), ("frame_id", "string"))

_U32 = Struct("<I")


class Cursor:
    """Walks one payload; every step is bound-checked."""

    def __init__(self, payload: memoryview, type_name: str) -> None:
        check_encapsulation(payload, type_name)
        self.payload, self.type_name, self.at = payload, type_name, HEAD_BYTES

    def take(self, size: int, alignment: int = 1) -> int:
        """Offset of the next `size` bytes in the payload."""
        start = self.at + -(self.at - HEAD_BYTES) % alignment
        if size > len(self.payload) - start:
            problem = f"{size} bytes are said to follow at byte {start}, the message has {len(self.payload)}"
            raise MessageLayoutError(self.type_name, problem)
        self.at = start + size
        return start

    def u8(self) -> int:
        return self.payload[self.take(1)]

    def u32(self) -> int:
        return int(_U32.unpack_from(self.payload, self.take(4, 4))[0])

    def stamp_ns(self) -> int:
        start = self.take(8, 4)
        sec = int.from_bytes(self.payload[start : start + 4], "little", signed=True)
        return sec * NS_PER_S + int(_U32.unpack_from(self.payload, start + 4)[0])

    def text(self) -> str:
        size = self.u32()
        start = self.take(size)
        return text_of(bytes(self.payload[start : start + size]), self.type_name)

    def count(self, least_bytes: int) -> int:
        """Length of a sequence whose elements take at least `least_bytes` each."""
        count = self.u32()
        if count * least_bytes > len(self.payload) - self.at:
            problem = f"a sequence declares {count} elements, {len(self.payload) - self.at} bytes are left"
            raise MessageLayoutError(self.type_name, problem)
        return count


def check_encapsulation(payload: memoryview, type_name: str) -> None:
    """Raises: MessageLayoutError (no CDR), ByteOrderError (big-endian CDR)."""
    if len(payload) < HEAD_BYTES:
        raise MessageLayoutError(type_name, f"{len(payload)} bytes are no CDR message")
    if payload[0] == 0 and payload[1] == 0:
        raise ByteOrderError(type_name)
    if payload[0] != 0 or payload[1] != 1:
        raise MessageLayoutError(type_name, f"encapsulation {bytes(payload[:2]).hex()} is not plain CDR (0001)")


def text_of(raw: bytes, type_name: str) -> str:
    try:
        return raw.rstrip(b"\0").decode()
    except UnicodeDecodeError:
        raise MessageLayoutError(type_name, f"{raw[:16]!r} is not UTF-8 text") from None


@dataclass(frozen=True, eq=False)
class Group:
    """Messages of one length and one set of string lengths: `rows` are their places in the input."""

    rows: NDArray[np.int64]
    table: Table

    def stamps_ns(self, sec: str = "sec", nanosec: str = "nanosec") -> NDArray[np.int64]:
        return np.asarray(self.table[sec].astype(np.int64) * NS_PER_S + self.table[nanosec], np.int64)

    def texts(self, name: str, type_name: str) -> list[str]:
        """The string of every message, decoded once per distinct value."""
        column = self.table[name]
        known = {raw: text_of(raw, type_name) for raw in set(column.tolist())}
        return [known[raw] for raw in column.tolist()]


def groups(
    payloads: Sequence[memoryview], describe: Callable[[memoryview], Sequence[Field]], type_name: str
) -> Iterator[Group]:
    """All payloads as tables: `describe` gives the fields of one payload, every row that agrees in length and string
    lengths shares its table. Raises: MessageLayoutError, ByteOrderError."""
    by_size: dict[int, list[int]] = {}
    for row, payload in enumerate(payloads):
        by_size.setdefault(len(payload), []).append(row)
    for size, listed in by_size.items():
        rows = np.array(listed, np.int64)
        raw = np.frombuffer(b"".join(payloads[row] for row in listed), np.uint8).reshape(len(rows), size)
        while len(rows):
            record = layout(payloads[rows[0]], describe(payloads[rows[0]]), type_name)
            table = raw.view(record)[:, 0]
            alike = _alike(table)
            yield Group(rows[alike], table[alike])
            rows, raw = rows[~alike], raw[~alike]


def _alike(table: Table) -> NDArray[np.bool_]:
    """Rows whose encapsulation and lengths are those of the first row; the first always is."""
    alike = np.ones(len(table), np.bool_)
    for name in table.dtype.names or ():
        if name == "encapsulation" or name.endswith(".length"):
            alike &= table[name] == table[name][0]
    return alike


def fits(payload: memoryview, fields: Sequence[Field], type_name: str) -> bool:
    """Whether the fields end where the payload does."""
    try:
        layout(payload, fields, type_name)
    except MessageLayoutError:
        return False
    return True


def layout(payload: memoryview, fields: Sequence[Field], type_name: str) -> np.dtype[np.void]:
    """The numpy record of exactly this payload: strings get the lengths that it declares.

    Lengths themselves are columns `<name>.length`, so that a table can check them in every row.
    Raises: MessageLayoutError when the fields end beyond or well before the payload's end.
    """
    cursor = Cursor(payload, type_name)
    names, offsets = ["encapsulation"], [0]
    formats: list[str | np.dtype[np.generic]] = ["<u2"]
    for name, kind in fields:
        if kind == "string":
            offsets.append(cursor.take(4, 4))
            size = int(_U32.unpack_from(payload, offsets[-1])[0])
            names += [f"{name}.length", name]
            formats += ["<u4", f"S{size}"]
            offsets.append(cursor.take(size))
            continue
        is_count = kind == "count"
        code = np.dtype("u4" if is_count else kind).newbyteorder("<")
        names.append(f"{name}.length" if is_count else name)
        formats.append(code)
        offsets.append(cursor.take(code.itemsize, code.base.itemsize))
    if len(payload) - cursor.at > PADDING_BYTES:
        problem = f"its fields end at byte {cursor.at}, the message has {len(payload)}"
        raise MessageLayoutError(type_name, problem)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(payload)})
