"""The table of contents of a zip, read with every length checked before anything is read or allocated.

**Conventions.** Offsets and sizes are bytes from the start of the archive. Nothing is trusted: the end record must be
the last thing in the file, the directory must sit right before it and hold exactly the records it announces, members
may not share bytes. Zip64 is understood. The same reader serves a submission (a file) and a frame in it (a buffer).

Source: PKWARE APPNOTE 6.3.10, §4.3.7, 4.3.12, 4.3.14–4.3.16, 4.5.3; overlaps: Fifield, "A better zip bomb" (WOOT 2019).
"""

import stat
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace

from services.eval.errors import (
    EncryptedError,
    NotZipError,
    OverlapError,
    SymlinkError,
    TooLargeError,
    TruncatedError,
    UnsupportedZipError,
)

STORED, DEFLATED = 0, 8
END, END64, LOCATOR64 = struct.Struct("<4s4H2IH"), struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI")
RECORD, LOCAL = struct.Struct("<4s6H3I5H2I"), struct.Struct("<4s5H3I2H")
MAX_COMMENT_BYTES = 2**16 - 1
MAX_NAME_BYTES = 512
ZIP64_EXTRA = 1
IN_EXTRA_32, IN_EXTRA_16 = 2**32 - 1, 2**16 - 1
# Bit 0 encrypted, 6 strongly encrypted, 13 masked headers.
ENCRYPTED_FLAGS = 1 << 0 | 1 << 6 | 1 << 13
MADE_BY_UNIX = 3

ReadAt = Callable[[int, int], bytes]


@dataclass(frozen=True)
class Member:
    """One file of an archive, as the central directory announces it; its bytes end before `limit`."""

    name: str
    method: int
    crc32: int
    packed_bytes: int
    unpacked_bytes: int
    offset: int
    limit: int


@dataclass(frozen=True)
class _End:
    entries: int
    directory_bytes: int
    directory_offset: int


def read_directory(read_at: ReadAt, size_bytes: int, max_entries: int) -> tuple[Member, ...]:
    """The members in the order of the directory; `read_at(offset, count)` reads within [0, size_bytes).

    Raises `NotZipError`, `TruncatedError`, `TooLargeError` (more than `max_entries`), `EncryptedError`, `SymlinkError`,
    `UnsupportedZipError`, `OverlapError`.
    """
    end = _read_end(read_at, size_bytes)
    limit_bytes = max_entries * (RECORD.size + MAX_NAME_BYTES)
    if end.entries > max_entries:
        raise TooLargeError(f"at most {max_entries} files in the archive", f"{end.entries} files")
    if end.directory_bytes > limit_bytes:
        raise TooLargeError(f"a directory of at most {limit_bytes} bytes", f"{end.directory_bytes} bytes")
    if end.entries * RECORD.size > end.directory_bytes or end.directory_offset + end.directory_bytes > size_bytes:
        raise TruncatedError(f"{end.entries} directory records inside the file", f"{end.directory_bytes} bytes of them")
    directory = read_at(end.directory_offset, end.directory_bytes)
    return _without_overlap(_parse(directory, end), end.directory_offset)


def payload_span(read_at: ReadAt, member: Member) -> tuple[int, int]:
    """Where the packed bytes of `member` start and stop; its local header must agree with the directory.

    Raises `TruncatedError`, `UnsupportedZipError`, `OverlapError`.
    """
    raw = read_at(member.offset, min(LOCAL.size + MAX_NAME_BYTES, member.limit - member.offset))
    if len(raw) < LOCAL.size or raw[:4] != b"PK\3\4":
        raise TruncatedError(f"the header of {member.name!r} at byte {member.offset}", "other bytes")
    _, _, flags, method, _, _, _, _, _, name_bytes, extra_bytes = LOCAL.unpack_from(raw)
    name = raw[LOCAL.size : LOCAL.size + name_bytes].decode("utf-8", "replace")
    if name != member.name or method != member.method or flags & ENCRYPTED_FLAGS:
        raise UnsupportedZipError(f"the directory's header of {member.name!r}", f"a local header of {name!r}")
    start = member.offset + LOCAL.size + name_bytes + extra_bytes
    stop = start + member.packed_bytes
    if stop > member.limit:
        raise OverlapError(f"{member.name!r} to end before byte {member.limit}", f"its end at {stop}")
    return start, stop


def _read_end(read_at: ReadAt, size_bytes: int) -> _End:
    tail_bytes = min(size_bytes, END.size + MAX_COMMENT_BYTES)
    tail = read_at(size_bytes - tail_bytes, tail_bytes)
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) - at < END.size:
        raise NotZipError("a zip that ends in its directory", "none" if size_bytes else "an empty file")
    _, disk, start_disk, here, entries, directory_bytes, offset, comment_bytes = END.unpack_from(tail, at)
    if at + END.size + comment_bytes != len(tail):
        raise NotZipError("the end record last in the file", f"{len(tail) - at - END.size - comment_bytes} bytes more")
    position = size_bytes - tail_bytes + at
    locator = read_at(position - LOCATOR64.size, LOCATOR64.size) if position >= LOCATOR64.size else b""
    if locator[:4] == b"PK\6\7":
        return _read_end64(read_at, locator, position - LOCATOR64.size)
    if disk or start_disk or here != entries:
        raise UnsupportedZipError("an archive in one part", f"part {disk} of several")
    if offset + directory_bytes != position:
        raise TruncatedError(f"the directory to end at byte {position}", f"its end at {offset + directory_bytes}")
    return _End(entries, directory_bytes, offset)


def _read_end64(read_at: ReadAt, locator: bytes, at: int) -> _End:
    """The wide end record named by the locator at byte `at`."""
    position = LOCATOR64.unpack(locator)[2]
    if position + END64.size > at:
        raise TruncatedError(f"a zip64 end record before byte {at}", f"one at byte {position}")
    record = read_at(position, END64.size)
    if record[:4] != b"PK\6\6":
        raise TruncatedError(f"a zip64 end record at byte {position}", "other bytes")
    _, _, _, _, disk, start_disk, here, entries, directory_bytes, offset = END64.unpack(record)
    if disk or start_disk or here != entries:
        raise UnsupportedZipError("an archive in one part", f"part {disk} of several")
    if offset + directory_bytes != position:
        raise TruncatedError(f"the directory to end at byte {position}", f"its end at {offset + directory_bytes}")
    return _End(entries, directory_bytes, offset)


def _parse(directory: bytes, end: _End) -> list[Member]:
    members: list[Member] = []
    at = 0
    for _ in range(end.entries):
        if directory[at : at + 4] != b"PK\1\2" or at + RECORD.size > len(directory):
            raise TruncatedError(f"{end.entries} directory records", f"{len(members)}")
        fields = RECORD.unpack_from(directory, at)
        stop = at + RECORD.size + sum(fields[10:13])
        if stop > len(directory):
            raise TruncatedError(f"{end.entries} directory records", f"{len(members)} whole ones")
        members.append(_member(fields, directory[at + RECORD.size : stop], end.directory_offset))
        at = stop
    if at != len(directory):
        raise UnsupportedZipError("directory records only", f"{len(directory) - at} bytes more")
    return members


def _member(fields: tuple[int, ...], variable: bytes, limit: int) -> Member:
    made_by, _, flags, method, _, _, crc32, packed, unpacked, name_bytes, extra_bytes, _, disk, _ = fields[1:15]
    attributes, at = fields[15:]
    if name_bytes > MAX_NAME_BYTES:
        raise TooLargeError(f"names of at most {MAX_NAME_BYTES} bytes", f"{name_bytes} bytes")
    name = variable[:name_bytes].decode("utf-8", "replace")
    if flags & ENCRYPTED_FLAGS:
        raise EncryptedError("plain files", f"an encrypted {name!r}")
    if method not in (STORED, DEFLATED) or disk not in (0, IN_EXTRA_16):
        raise UnsupportedZipError("method 0 (store) or 8 (deflate)", f"method {method} for {name!r}")
    if made_by >> 8 == MADE_BY_UNIX and stat.S_ISLNK(attributes >> 16):
        raise SymlinkError("files", f"a symbolic link {name!r}")
    if IN_EXTRA_32 in (packed, unpacked, at):
        extra = variable[name_bytes : name_bytes + extra_bytes]
        unpacked, packed, at = _zip64_values(extra, (unpacked, packed, at), name)
    if method == STORED and packed != unpacked:
        raise UnsupportedZipError(f"{unpacked} stored bytes for {name!r}", f"{packed}")
    return Member(name, method, crc32, packed, unpacked, at, limit)


def _zip64_values(extra: bytes, values: tuple[int, int, int], name: str) -> tuple[int, int, int]:
    """The 8-byte values that stand, in this order, for those of `values` that are 0xFFFFFFFF."""
    wide, at = b"", 0
    while at + 4 <= len(extra):
        tag, count = struct.unpack_from("<2H", extra, at)
        wide = extra[at + 4 : at + 4 + count] if tag == ZIP64_EXTRA else wide
        at += 4 + count
    needed = sum(value == IN_EXTRA_32 for value in values)
    if len(wide) < 8 * needed:
        raise TruncatedError(f"{needed} zip64 values for {name!r}", f"{len(wide)} bytes")
    found = iter(struct.unpack_from(f"<{needed}Q", wide))
    first, second, third = (next(found) if value == IN_EXTRA_32 else value for value in values)
    return first, second, third


def _without_overlap(members: list[Member], limit: int) -> tuple[Member, ...]:
    """Each member with the start of the next one as its limit."""
    ordered = sorted(range(len(members)), key=lambda index: members[index].offset)
    bounded: list[Member] = list(members)
    for index in reversed(ordered):
        member = members[index]
        least = LOCAL.size + len(member.name.encode()) + member.packed_bytes
        if member.offset + least > limit:
            raise OverlapError(f"{member.name!r} to end before byte {limit}", f"its end after {member.offset + least}")
        bounded[index] = replace(member, limit=limit)
        limit = member.offset
    return tuple(bounded)
