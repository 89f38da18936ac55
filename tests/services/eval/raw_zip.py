"""A zip written byte by byte, every field of every header open to lies.

**Conventions.** What is not overridden is as an honest writer makes it: stored, narrow, no flags. Overrides are by
field name and change the header only; where things lie stays as it is.
"""

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

RECORD, LOCAL = struct.Struct("<4s6H3I5H2I"), struct.Struct("<4s5H3I2H")
END, END64, LOCATOR64 = struct.Struct("<4s4H2IH"), struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI")
LOCAL_FIELDS = ("need", "flags", "method", "time", "date", "crc32", "packed", "unpacked", "name_bytes", "extra_bytes")
CENTRAL_FIELDS = ("made_by", *LOCAL_FIELDS, "comment_bytes", "disk", "internal", "attributes", "offset")
WIDE = 2**32 - 1

Lies = Mapping[str, int]


@dataclass(frozen=True)
class Entry:
    """One file; `local` and `central` override fields, `between` are bytes that belong to nobody."""

    name: bytes
    payload: bytes
    method: int = 0
    flags: int = 0
    local: Lies = field(default_factory=dict)
    central: Lies = field(default_factory=dict)
    local_name: bytes | None = None
    local_extra: bytes = b""
    extra: bytes = b""
    between: bytes = b""

    @property
    def packed(self) -> bytes:
        if self.method == 0:
            return self.payload
        squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
        return squeeze.compress(self.payload) + squeeze.flush()

    def facts(self, name: bytes, extra: bytes) -> dict[str, int]:
        return {
            **{"made_by": 20, "need": 20, "flags": self.flags, "method": self.method, "time": 0, "date": 33},
            **{"crc32": zlib.crc32(self.payload), "packed": len(self.packed), "unpacked": len(self.payload)},
            **{"name_bytes": len(name), "extra_bytes": len(extra), "comment_bytes": 0, "disk": 0, "internal": 0},
            **{"attributes": 0, "offset": 0},
        }


@dataclass(frozen=True)
class Ending:
    """The end records: `narrow`, `wide` and `locator` override fields; there are wide ones where `wide` is not None."""

    narrow: Lies = field(default_factory=dict)
    wide: Lies | None = None
    locator: Lies = field(default_factory=dict)
    comment: bytes = b""
    prefix: bytes = b""
    behind_wide: bytes = b""
    behind: bytes = b""


def raw_zip(entries: Sequence[Entry], ending: Ending = Ending()) -> bytes:
    """The archive; `ending.prefix` comes first, and offsets know of it."""
    body, directory = ending.prefix, b""
    for entry in entries:
        facts = entry.facts(entry.name, entry.extra) | {"offset": len(body)} | dict(entry.central)
        directory += RECORD.pack(b"PK\1\2", *(facts[name] for name in CENTRAL_FIELDS)) + entry.name + entry.extra
        name = entry.name if entry.local_name is None else entry.local_name
        local = entry.facts(name, entry.local_extra) | dict(entry.local)
        head = LOCAL.pack(b"PK\3\4", *(local[name] for name in LOCAL_FIELDS))
        body += head + name + entry.local_extra + entry.packed + entry.between
    facts = {"entries": len(entries), "here": len(entries), "bytes": len(directory), "offset": len(body)}
    wide = b"" if ending.wide is None else _wide(facts, ending, len(body) + len(directory))
    return body + directory + wide + _narrow(facts, ending) + ending.behind


def wide_extra(*values: int, tag: int = 1) -> bytes:
    """A zip64 extra field of these 8-byte values."""
    return struct.pack(f"<2H{len(values)}Q", tag, 8 * len(values), *values)


def stretched(entry: Entry, **lies: int) -> Entry:
    """An honest wide entry: sizes in extra fields, in both headers; `lies` replace `unpacked` or `packed` there."""
    facts = {"unpacked": len(entry.payload), "packed": len(entry.packed)} | lies
    extra = wide_extra(facts["unpacked"], facts["packed"])
    saturated = {"packed": WIDE, "unpacked": WIDE}
    return replace(entry, extra=extra, local_extra=extra, local=saturated, central=saturated)


def _narrow(facts: Mapping[str, int], ending: Ending) -> bytes:
    said = {"disk": 0, "start_disk": 0, "comment": len(ending.comment), **facts, **ending.narrow}
    names = ("disk", "start_disk", "here", "entries", "bytes", "offset", "comment")
    return END.pack(b"PK\5\6", *(said[name] for name in names)) + ending.comment


def _wide(facts: Mapping[str, int], ending: Ending, at: int) -> bytes:
    said = {"size": END64.size - 12, "made_by": 45, "need": 45, "disk": 0, "start_disk": 0, **facts}
    said |= dict(ending.wide or {})
    names = ("size", "made_by", "need", "disk", "start_disk", "here", "entries", "bytes", "offset")
    record = END64.pack(b"PK\6\6", *(said[name] for name in names)) + ending.behind_wide
    where = {"disk": 0, "offset": at, "disks": 1, **ending.locator}
    return record + LOCATOR64.pack(b"PK\6\7", where["disk"], where["offset"], where["disks"])
