"""The table of contents of a zip, read with every length checked before anything is read or allocated.

**Conventions.** Offsets and sizes are bytes from the start of the archive. Nothing is trusted: the directory holds
exactly the records it announces, every header says the same as the directory, members share no bytes, and no bytes lie
between or before them but data descriptors, so that no two readers can see different files. Zip64 is understood. The
same reader serves a submission (a file) and a frame in it (a buffer).

Source: PKWARE APPNOTE 6.3.10, §4.3.7, 4.3.9, 4.3.12, 4.4.4, D; overlaps: Fifield, "A better zip bomb" (WOOT 2019).
"""

import stat
import struct
from dataclasses import dataclass, replace

from stone_submissions.errors import (
    EncryptedError,
    OverlapError,
    SymlinkError,
    TooLargeError,
    TruncatedError,
    UnsupportedZipError,
)
from stone_submissions.zip_end import IN_EXTRA_16, End, ReadAt, read_end
from stone_submissions.zip_extra import check_other_name, extra_fields, wide_values

STORED, DEFLATED = 0, 8
RECORD, LOCAL = struct.Struct("<4s6H3I5H2I"), struct.Struct("<4s5H3I2H")
MAX_NAME_BYTES, MAX_EXTRA_BYTES = 512, 1024
# Bit 0 encrypted, 6 strongly encrypted, 13 masked headers.
ENCRYPTED_FLAGS = 1 << 0 | 1 << 6 | 1 << 13
DESCRIBED_BEHIND = 1 << 3  # sizes and CRC follow the data
IN_UTF8 = 1 << 11
LONGEST_DESCRIPTOR_BYTES = 24
MADE_BY_UNIX, MADE_BY_MACOS = 3, 19


@dataclass(frozen=True)
class ZipMember:
    """One file of an archive, as the central directory announces it; its bytes end before `limit`."""

    name: str
    method: int
    crc32: int
    packed_bytes: int
    unpacked_bytes: int
    offset: int
    limit: int


def read_directory(read_at: ReadAt, size_bytes: int, max_entries: int) -> tuple[ZipMember, ...]:
    """The members in the order of the directory; `read_at(offset, count)` reads within [0, size_bytes).

    Raises `NotZipError`, `TruncatedError`, `TooLargeError` (more than `max_entries`), `EncryptedError`, `SymlinkError`,
    `UnsupportedZipError`, `OverlapError`.
    """
    end = read_end(read_at, size_bytes)
    limit_bytes = max_entries * (RECORD.size + MAX_NAME_BYTES)
    if end.entries > max_entries:
        raise TooLargeError(f"at most {max_entries} files in the archive", f"{end.entries} files")
    if end.directory_bytes > limit_bytes:
        raise TooLargeError(f"a directory of at most {limit_bytes} bytes", f"{end.directory_bytes} bytes")
    if end.entries * RECORD.size > end.directory_bytes or end.directory_offset + end.directory_bytes > size_bytes:
        raise TruncatedError(f"{end.entries} directory records inside the file", f"{end.directory_bytes} bytes of them")
    directory = read_at(end.directory_offset, end.directory_bytes)
    return _without_overlap(_parse(directory, end), end.directory_offset)


def payload_span(read_at: ReadAt, member: ZipMember) -> tuple[int, int]:
    """Where the packed bytes of `member` start and stop; its local header must agree with the directory.

    Raises `TruncatedError`, `UnsupportedZipError`, `OverlapError`.
    """
    most = LOCAL.size + MAX_NAME_BYTES + MAX_EXTRA_BYTES
    raw = read_at(member.offset, min(most, member.limit - member.offset))
    if len(raw) < LOCAL.size or raw[:4] != b"PK\3\4":
        raise TruncatedError(f"the header of {member.name!r} at byte {member.offset}", "other bytes")
    _, _, flags, method, _, _, _, *sizes, name_bytes, extra_bytes = LOCAL.unpack_from(raw)
    start = LOCAL.size + name_bytes + extra_bytes
    if name_bytes > MAX_NAME_BYTES or extra_bytes > MAX_EXTRA_BYTES:
        raise TooLargeError(f"a header of at most {most} bytes for {member.name!r}", f"{start} bytes")
    name = _decoded(raw[LOCAL.size : LOCAL.size + name_bytes], flags)
    if name != member.name or method != member.method or flags & ENCRYPTED_FLAGS:
        raise UnsupportedZipError(f"the directory's header of {member.name!r}", f"a local header of {name!r}")
    fields = extra_fields(raw[start - extra_bytes : start], name)
    _check_sizes(member, wide_values(fields, (sizes[1], sizes[0]), name), flags)
    return _bounded(member, member.offset + start, LONGEST_DESCRIPTOR_BYTES if flags & DESCRIBED_BEHIND else 0)


def _check_sizes(member: ZipMember, unpacked_packed: tuple[int, ...], flags: int) -> None:
    """The local header's sizes are the directory's, or 0 where they follow the data."""
    for said, known in zip(unpacked_packed, (member.unpacked_bytes, member.packed_bytes), strict=True):
        if said != known and not (flags & DESCRIBED_BEHIND and said == 0):
            raise UnsupportedZipError(f"{known} bytes of {member.name!r}, as in the directory", f"{said}")


def _bounded(member: ZipMember, start: int, descriptor_bytes: int) -> tuple[int, int]:
    stop = start + member.packed_bytes
    if stop > member.limit:
        raise OverlapError(f"{member.name!r} to end before byte {member.limit}", f"its end at {stop}")
    if member.limit - stop > descriptor_bytes:
        raise UnsupportedZipError(f"the next file after {member.name!r}", f"{member.limit - stop} bytes of no file")
    return start, stop


def _parse(directory: bytes, end: End) -> list[ZipMember]:
    members: list[ZipMember] = []
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


def _member(fields: tuple[int, ...], variable: bytes, limit: int) -> ZipMember:
    made_by, _, flags, method, _, _, crc32, packed, unpacked, name_bytes, extra_bytes, _, disk, _ = fields[1:15]
    attributes, at = fields[15:]
    if name_bytes > MAX_NAME_BYTES:
        raise TooLargeError(f"names of at most {MAX_NAME_BYTES} bytes", f"{name_bytes} bytes")
    name = _decoded(variable[:name_bytes], flags)
    if flags & ENCRYPTED_FLAGS:
        raise EncryptedError("plain files", f"an encrypted {name!r}")
    if method not in (STORED, DEFLATED) or disk not in (0, IN_EXTRA_16):
        raise UnsupportedZipError("method 0 (store) or 8 (deflate)", f"method {method} for {name!r}")
    if made_by >> 8 in (MADE_BY_UNIX, MADE_BY_MACOS) and stat.S_ISLNK(attributes >> 16):
        raise SymlinkError("files", f"a symbolic link {name!r}")
    extra = extra_fields(variable[name_bytes : name_bytes + extra_bytes], name)
    check_other_name(extra, name)
    unpacked, packed, at = wide_values(extra, (unpacked, packed, at), name)
    if method == STORED and packed != unpacked:
        raise UnsupportedZipError(f"{unpacked} stored bytes for {name!r}", f"{packed}")
    return ZipMember(name, method, crc32, packed, unpacked, at, limit)


def _decoded(name: bytes, flags: int) -> str:
    """In UTF-8 where that is announced, else in code page 437, which has a character for every byte."""
    try:
        return name.decode("utf-8" if flags & IN_UTF8 else "cp437")
    except UnicodeDecodeError as error:
        raise UnsupportedZipError("a name in UTF-8, as its header says", f"{name[:40]!r}") from error


def _without_overlap(members: list[ZipMember], limit: int) -> tuple[ZipMember, ...]:
    """Each member with the start of the next one as its limit."""
    ordered = sorted(range(len(members)), key=lambda index: members[index].offset)
    bounded: list[ZipMember] = list(members)
    for index in reversed(ordered):
        member = members[index]
        least = LOCAL.size + member.packed_bytes
        if member.offset + least > limit:
            raise OverlapError(f"{member.name!r} to end before byte {limit}", f"its end after {member.offset + least}")
        bounded[index] = replace(member, limit=limit)
        limit = member.offset
    if limit:
        raise UnsupportedZipError("the first file at byte 0", f"{limit} bytes before it")
    return tuple(bounded)
