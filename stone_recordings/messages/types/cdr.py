"""Plain CDR as ROS 2 writes it: check, walk, and stack many messages of one layout as rows of bytes.

**Conventions.** A payload is 4 bytes of encapsulation, then the body; alignment counts from the body's first byte.
Only little-endian plain CDR is read. Source: OMG DDSI-RTPS 2.5, 10; the walk checks every length against the payload
before it is used.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError

HEAD_BYTES = 4
# rmw implementations may pad a message to four bytes: the number of bytes that may follow the last field.
PADDING_BYTES = 3
NS_PER_S = 1_000_000_000
# The splits of one size by comparison before every message is measured individually. The first way is fast for many
# equal messages, the second is linear for hostile ones that all differ.
MOST_SPLITS = 16

_U32 = Struct("<I")
Layout = TypeVar("Layout")


class Cursor:
    """Walks one payload; every step is bound-checked."""

    def __init__(self, payload: memoryview, type_name: str) -> None:
        check_encapsulation(payload, type_name)
        self.payload, self.type_name, self.at = payload, type_name, HEAD_BYTES

    def take(self, size: int, alignment: int = 1) -> int:
        """Return the offset of the next `size` bytes in the payload, and advance past them."""
        start = self.at + -(self.at - HEAD_BYTES) % alignment
        if size > len(self.payload) - start:
            problem = f"{size} bytes are declared at byte {start}, the message has {len(self.payload)}"
            raise MessageLayoutError(self.type_name, problem)
        self.at = start + size
        return start

    def u8(self) -> int:
        return self.payload[self.take(1)]

    def length(self) -> tuple[int, int]:
        """Return the offset of a length, and the length."""
        start = self.take(4, 4)
        return start, int(_U32.unpack_from(self.payload, start)[0])

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

    def end(self) -> None:
        """Check that nothing but padding follows."""
        if len(self.payload) - self.at > PADDING_BYTES:
            problem = f"its fields end at byte {self.at}, the message has {len(self.payload)}"
            raise MessageLayoutError(self.type_name, problem)

    def count(self, least_bytes: int) -> int:
        """Return the length of a sequence whose elements take at least `least_bytes` each."""
        return self.bounded(self.u32(), least_bytes)

    def bounded(self, count: int, least_bytes: int) -> int:
        """Return `count`, if that many elements can follow."""
        if count * least_bytes > len(self.payload) - self.at:
            problem = f"a sequence declares {count} elements, {len(self.payload) - self.at} bytes are left"
            raise MessageLayoutError(self.type_name, problem)
        return count


def check_encapsulation(payload: memoryview, type_name: str) -> None:
    """Check the encapsulation. Raises: MessageLayoutError (no CDR), ByteOrderError (big-endian CDR)."""
    if len(payload) < HEAD_BYTES:
        raise MessageLayoutError(type_name, f"{len(payload)} bytes are not a CDR message")
    if payload[0] == 0 and payload[1] == 0:
        raise ByteOrderError(type_name)
    if payload[0] != 0 or payload[1] != 1:
        raise MessageLayoutError(type_name, f"encapsulation {bytes(payload[:2]).hex()} is not plain CDR (0001)")


def text_of(raw: bytes, type_name: str) -> str:
    """Return the text without its terminator; earlier NULs are the sender's own (NovAtel's driver pads station ids)."""
    try:
        return raw.removesuffix(b"\0").decode()
    except UnicodeDecodeError:
        raise MessageLayoutError(type_name, f"{raw[:16]!r} is not UTF-8 text") from None


@dataclass(frozen=True, eq=False)
class Sheet(Generic[Layout]):
    """Messages of one length and one layout: `rows` are their indices in the input, `raw` (n, size) their bytes."""

    rows: NDArray[np.int64]
    raw: NDArray[np.uint8]
    layout: Layout


Measure = Callable[[memoryview], tuple[Layout, Sequence[int]]]


def sheets(payloads: Sequence[memoryview], measure: Measure[Layout]) -> Iterator[Sheet[Layout]]:
    """Yield all payloads, stacked by layout; `measure` returns the layout of one and the offsets of the lengths in it.

    Every message of the same size with the same words at these offsets shares the layout. Raises the errors of
    `measure`.
    """
    by_size: dict[int, list[int]] = {}
    for row, payload in enumerate(payloads):
        by_size.setdefault(len(payload), []).append(row)
    for size, listed in by_size.items():
        rows = np.array(listed, np.int64)
        for _split in range(MOST_SPLITS):
            layout, places = measure(payloads[rows[0]])
            raw = _stacked(payloads, rows, size)
            alike = _alike(raw, places)
            if alike.all():
                yield Sheet(rows, raw, layout)
                break
            yield Sheet(rows[alike], raw[alike], layout)
            rows = rows[~alike]
        else:
            yield from _measured_each(payloads, rows, measure)


def _stacked(payloads: Sequence[memoryview], rows: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    return np.frombuffer(b"".join([payloads[row] for row in rows]), np.uint8).reshape(len(rows), size)


def _alike(raw: NDArray[np.uint8], places: Sequence[int]) -> NDArray[np.bool_]:
    """Return the rows whose encapsulation and lengths equal those of the first row; the first always does."""
    words = np.array([0, *places], np.int64)
    columns = (words[:, None] + np.arange(4)).ravel()
    return np.asarray((raw[:, columns] == raw[0, columns]).all(axis=1))


def _measured_each(
    payloads: Sequence[memoryview], rows: NDArray[np.int64], measure: Measure[Layout]
) -> Iterator[Sheet[Layout]]:
    by_lengths: dict[bytes, list[int]] = {}
    for row in rows.tolist():
        payload = payloads[row]
        _layout, places = measure(payload)
        key = b"".join(bytes(payload[offset : offset + 4]) for offset in (0, *places))
        by_lengths.setdefault(key, []).append(row)
    for listed in by_lengths.values():
        alike = np.array(listed, np.int64)
        first = payloads[listed[0]]
        yield Sheet(alike, _stacked(payloads, alike, len(first)), measure(first)[0])
