"""The wire format of ROS 1 bags, version 2.0: walk records and read their headers, trusting no length.

**Conventions.** A record is a u32 length, a header of that size, another u32 and data of that size; everything is
little-endian. A header is fields, each a u32 length and name=value, in any order; `op` is the kind of the record.
`where` is the subject of the sentence about an invalid record. Source: wiki.ros.org/Bags/Format/2.0.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct

from stone_recordings.bags.errors import MalformedBagError

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
PREFIX_BYTES = 4
# The longest header of a recorder holds a topic's name; a connection's description is data, not header.
MOST_HEADER_BYTES = 1 << 16
NS_PER_S = 1_000_000_000

_U32, _U64, _TIME = Struct("<I"), Struct("<Q"), Struct("<II")


class HeaderFields:
    """The fields of one header by name."""

    def __init__(self, values: Mapping[bytes, bytes], where: str) -> None:
        self._values, self.where = values, where

    @property
    def op(self) -> int:
        """The opcode; 0 without one, or for one of another size."""
        value = self._values.get(b"op", b"")
        return value[0] if len(value) == 1 else 0

    def u32(self, name: str) -> int:
        return int(_U32.unpack(self._sized(name, 4))[0])

    def u64(self, name: str) -> int:
        return int(_U64.unpack(self._sized(name, 8))[0])

    def time_ns(self, name: str) -> int:
        sec, nsec = _TIME.unpack(self._sized(name, 8))
        return int(sec) * NS_PER_S + int(nsec)

    def text(self, name: str) -> str:
        """Return a text; "" if the field is missing; invalid UTF-8 is replaced."""
        return self._values.get(name.encode(), b"").decode(errors="replace")

    def _sized(self, name: str, size: int) -> bytes:
        value = self._values.get(name.encode())
        if value is None or len(value) != size:
            fault = "is missing" if value is None else f"has {len(value)} bytes"
            raise MalformedBagError(self.where, f"the header's field {name!r} of {size} bytes {fault}")
        return value


@dataclass(frozen=True, slots=True)
class Ros1Record:
    """A header, and the half-open byte range of the data; the record starts at `at`."""

    fields: HeaderFields
    at: int
    start: int
    stop: int

    @property
    def op(self) -> int:
        return self.fields.op


def head_at(view: memoryview, at: int, where: str) -> Ros1Record:
    """Return the record at `at`, whose header lies in `view`; its data may end beyond it. Raises: MalformedBagError."""
    header_stop = at + PREFIX_BYTES + (header_bytes := _length_at(view, at, where))
    if header_bytes > MOST_HEADER_BYTES or header_stop > len(view) - PREFIX_BYTES:
        problem = f"the record at byte {at} declares a header of {header_bytes} bytes, {len(view) - at} are left"
        raise MalformedBagError(where, problem)
    fields = header_fields(view[at + PREFIX_BYTES : header_stop], where)
    start = header_stop + PREFIX_BYTES
    return Ros1Record(fields, at, start, start + _length_at(view, header_stop, where))


def record_at(view: memoryview, at: int, where: str) -> Ros1Record:
    """Return the whole record at `at`. Raises: MalformedBagError."""
    record = head_at(view, at, where)
    if record.stop > len(view):
        declared_bytes, left_bytes = record.stop - record.start, len(view) - record.start
        problem = f"the record at byte {at} (op {record.op}) declares {declared_bytes} bytes, {left_bytes} are left"
        raise MalformedBagError(where, problem)
    return record


def header_fields(header: memoryview, where: str) -> HeaderFields:
    """Return the fields; the last field of a name counts. Raises: MalformedBagError."""
    values: dict[bytes, bytes] = {}
    raw, at = bytes(header), 0
    while at < len(raw):
        size = _U32.unpack_from(raw, at)[0] if at + PREFIX_BYTES <= len(raw) else len(raw)
        name, equals, value = raw[at + PREFIX_BYTES : at + PREFIX_BYTES + size].partition(b"=")
        at += PREFIX_BYTES + size
        if at > len(raw) or not equals:
            raise MalformedBagError(where, "a header's fields are not name=value of the declared length")
        values[name] = value
    return HeaderFields(values, where)


def _length_at(view: memoryview, at: int, where: str) -> int:
    if not 0 <= at <= len(view) - PREFIX_BYTES:
        raise MalformedBagError(where, f"a record is declared at byte {at}, the data ends at {len(view)}")
    return int(_U32.unpack_from(view, at)[0])
