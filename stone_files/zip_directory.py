"""A zip's central directory, read with every length checked before anything is read or allocated.

**Conventions.** Offsets and sizes are bytes from the start of the archive. Nothing is trusted, so that no two readers
can see different files. The directory must have exactly the announced records, and every header must agree with it.
Members must share no bytes, and only data descriptors may lie between them. Zip64 is supported. The same reader serves
a submission (a file) and a frame in it (a buffer).

Source: PKWARE APPNOTE 6.3.10, §4.3.7, 4.3.9, 4.3.12, 4.4.4, D; overlaps: Fifield, "A better zip bomb" (WOOT 2019).
"""

import stat
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone_base.errors import StoneError
from stone_files.archives import CENTRAL, DEFLATED, END, END_64, LOCAL, LOCATOR, STORED


class ZipFaultError(StoneError):
    """A zip has the fault `code`; the sentence contains `expected` and `actual`."""

    def __init__(self, code: str, expected: str, actual: str) -> None:
        self.code, self.expected, self.actual = code, expected, actual
        super().__init__(f"expected {expected}, found {actual}")


# The end record of a zip, narrow or zip64: position of the directory and number of files. The end record is last in the
# file, directly after the directory. Frames are archives too: if a zip is cut off inside a stored frame, the last end
# record belongs to that frame. If there is a zip64 record, the narrow one has the same values or 0xFF…. Source: PKWARE
# APPNOTE 6.3.10, §4.3.14–4.3.16, 4.4.1.4.


MAX_COMMENT_BYTES = 2**16 - 1
IN_EXTRA_32, IN_EXTRA_16 = 2**32 - 1, 2**16 - 1
FIRST_FILE = b"PK\3\4"
BEFORE_ITS_SIZE = 12  # the size field of a zip64 record excludes signature and size

ReadAt = Callable[[int, int], bytes]


@dataclass(frozen=True)
class End:
    """The directory as the archive's end record announces it."""

    entries: int
    directory_bytes: int
    directory_offset: int


def read_end(read_at: ReadAt, size_bytes: int) -> End:
    """Return the end record, reading at most 66 kB. Raises `not_zip`, `truncated`, `unsupported_zip`."""
    tail_bytes = min(size_bytes, END.size + MAX_COMMENT_BYTES)
    tail = read_at(size_bytes - tail_bytes, tail_bytes)
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) - at < END.size:
        if _begins_as_zip(read_at):
            raise _cut_short(size_bytes)
        raise ZipFaultError("not_zip", "a zip that ends with its directory", "none" if size_bytes else "an empty file")
    _, disk, start_disk, here, entries, directory_bytes, offset, comment_bytes = END.unpack_from(tail, at)
    position = size_bytes - tail_bytes + at
    narrow = End(entries, directory_bytes, offset)
    if at + END.size + comment_bytes != len(tail):
        if _begins_as_zip(read_at) and not _may_end_at(narrow, position):
            raise _cut_short(size_bytes)
        raise ZipFaultError(
            "not_zip", "the end record last in the file", f"{len(tail) - at - END.size - comment_bytes} bytes more"
        )
    locator = read_at(position - LOCATOR.size, LOCATOR.size) if position >= LOCATOR.size else b""
    if locator[:4] == b"PK\6\7":
        return _same(narrow, _read_wide(read_at, locator, position - LOCATOR.size))
    return _checked(narrow, (disk, start_disk, here - entries), position)


def _begins_as_zip(read_at: ReadAt) -> bool:
    return read_at(0, len(FIRST_FILE)) == FIRST_FILE


def _may_end_at(end: End, position: int) -> bool:
    """Return whether a record at byte `position` can belong to this archive; records of inner archives have other
    offsets.
    """
    if IN_EXTRA_32 in (end.directory_bytes, end.directory_offset):
        return True
    return position - end.directory_offset - end.directory_bytes in (0, END_64.size + LOCATOR.size)


def _cut_short(size_bytes: int) -> ZipFaultError:
    return ZipFaultError(
        "truncated", "the zip's directory at its end", f"none: the file is cut off after {size_bytes} bytes"
    )


def _read_wide(read_at: ReadAt, locator: bytes, at: int) -> End:
    """Return the zip64 end record that the locator at byte `at` refers to."""
    _, disk, position, disks = LOCATOR.unpack(locator)
    if position + END_64.size > at:
        raise ZipFaultError("truncated", f"a zip64 end record before byte {at}", f"a record at byte {position}")
    record = read_at(position, END_64.size)
    if record[:4] != b"PK\6\6":
        raise ZipFaultError("truncated", f"a zip64 end record at byte {position}", "other bytes")
    _, size_bytes, _, _, own_disk, start_disk, here, entries, directory_bytes, offset = END_64.unpack(record)
    if size_bytes != at - position - BEFORE_ITS_SIZE:
        raise ZipFaultError(
            "truncated", f"a zip64 end record that ends at byte {at}", f"a record of {size_bytes} bytes"
        )
    parts = (disk, own_disk, start_disk, here - entries, max(disks, 1) - 1)
    return _checked(End(entries, directory_bytes, offset), parts, position)


def _checked(end: End, parts: tuple[int, ...], position: int) -> End:
    """Return the end with a directory that stops at byte `position`; `parts` are zeros for an archive in one part."""
    if any(parts):
        raise ZipFaultError("unsupported_zip", "an archive in one part", "an archive in several parts")
    if end.directory_offset + end.directory_bytes != position:
        stop = end.directory_offset + end.directory_bytes
        raise ZipFaultError(
            "truncated", f"the directory to end at byte {position}", f"a directory that ends at byte {stop}"
        )
    return end


def _same(narrow: End, wide: End) -> End:
    pairs = (
        (narrow.entries, wide.entries, IN_EXTRA_16),
        (narrow.directory_bytes, wide.directory_bytes, IN_EXTRA_32),
        (narrow.directory_offset, wide.directory_offset, IN_EXTRA_32),
    )
    for value, meant, elsewhere in pairs:
        if value not in (meant, elsewhere):
            raise ZipFaultError("unsupported_zip", f"{meant} in both end records, as in the zip64 record", f"{value}")
    return wide


MAX_NAME_BYTES, MAX_EXTRA_BYTES = 512, 1024
# Bit 0: encrypted; 6: strongly encrypted; 13: masked headers.
ENCRYPTED_FLAGS = 1 << 0 | 1 << 6 | 1 << 13
DESCRIBED_BEHIND = 1 << 3  # sizes and CRC follow the data
IN_UTF8 = 1 << 11
LONGEST_DESCRIPTOR_BYTES = 24
PIECE_BYTES, MOST_RECORD_BYTES = 2**20, CENTRAL.size + 3 * (2**16 - 1)
MADE_BY_UNIX, MADE_BY_MACOS = 3, 19


@dataclass(frozen=True)
class ZipMember:
    """One file of an archive, from the central directory; its bytes end before `limit`."""

    name: str
    method: int
    crc32: int
    packed_bytes: int
    unpacked_bytes: int
    offset: int
    limit: int


def read_directory(read_at: ReadAt, size_bytes: int, max_entries: int) -> tuple[ZipMember, ...]:
    """Return the members in directory order; `read_at(offset, count)` reads within [0, size_bytes).

    Raises `not_zip`, `truncated`, `too_large` (more than `max_entries`), `encrypted`, `symlink`, `unsupported_zip`,
    `overlapping_files`.
    """
    end = checked_end(read_at, size_bytes, max_entries)
    members = list(directory_members(read_at, end))
    offsets, packed = (
        np.array(values, np.uint64)
        for values in ([member.offset for member in members], [member.packed_bytes for member in members])
    )
    limits = limits_of(offsets, packed, end.directory_offset).tolist()
    return tuple(replace(member, limit=limit) for member, limit in zip(members, limits, strict=True))


def checked_end(read_at: ReadAt, size_bytes: int, max_entries: int) -> End:
    """Return the end record if its directory fits `max_entries`. Raises the errors of `read_directory`."""
    end = read_end(read_at, size_bytes)
    limit_bytes = max_entries * (CENTRAL.size + MAX_NAME_BYTES)
    if end.entries > max_entries:
        raise ZipFaultError("too_large", f"at most {max_entries} files in the archive", f"{end.entries} files")
    if end.directory_bytes > limit_bytes:
        raise ZipFaultError("too_large", f"a directory of at most {limit_bytes} bytes", f"{end.directory_bytes} bytes")
    if end.entries * CENTRAL.size > end.directory_bytes or end.directory_offset + end.directory_bytes > size_bytes:
        raise ZipFaultError(
            "truncated",
            f"{end.entries} directory records inside the file",
            f"{end.directory_bytes} bytes of directory records",
        )
    return end


def payload_span(read_at: ReadAt, member: ZipMember) -> tuple[int, int]:
    """Return start and stop of the packed bytes of `member`; its local header must agree with the directory.

    Raises `truncated`, `unsupported_zip`, `overlapping_files`.
    """
    most = LOCAL.size + MAX_NAME_BYTES + MAX_EXTRA_BYTES
    raw = read_at(member.offset, min(most, member.limit - member.offset))
    if len(raw) < LOCAL.size or raw[:4] != b"PK\3\4":
        raise ZipFaultError("truncated", f"the header of {member.name!r} at byte {member.offset}", "other bytes")
    _, _, flags, method, _, _, _, *sizes, name_bytes, extra_bytes = LOCAL.unpack_from(raw)
    start = LOCAL.size + name_bytes + extra_bytes
    if name_bytes > MAX_NAME_BYTES or extra_bytes > MAX_EXTRA_BYTES:
        raise ZipFaultError("too_large", f"a header of at most {most} bytes for {member.name!r}", f"{start} bytes")
    name = _decoded(raw[LOCAL.size : LOCAL.size + name_bytes], flags)
    if name != member.name or method != member.method or flags & ENCRYPTED_FLAGS:
        raise ZipFaultError(
            "unsupported_zip", f"the directory's header of {member.name!r}", f"a local header of {name!r}"
        )
    fields = extra_fields(raw[start - extra_bytes : start], name)
    _check_sizes(member, wide_values(fields, (sizes[1], sizes[0]), name), flags)
    return _bounded(member, member.offset + start, LONGEST_DESCRIPTOR_BYTES if flags & DESCRIBED_BEHIND else 0)


def _check_sizes(member: ZipMember, unpacked_packed: tuple[int, ...], flags: int) -> None:
    """Check that the local header's sizes equal the directory's, or are 0 if they follow the data."""
    for size, known in zip(unpacked_packed, (member.unpacked_bytes, member.packed_bytes), strict=True):
        if size != known and not (flags & DESCRIBED_BEHIND and size == 0):
            raise ZipFaultError("unsupported_zip", f"{known} bytes of {member.name!r}, as in the directory", f"{size}")


def _bounded(member: ZipMember, start: int, descriptor_bytes: int) -> tuple[int, int]:
    stop = start + member.packed_bytes
    if stop > member.limit:
        raise ZipFaultError(
            "overlapping_files", f"{member.name!r} to end before byte {member.limit}", f"an end at byte {stop}"
        )
    if member.limit - stop > descriptor_bytes:
        raise ZipFaultError(
            "unsupported_zip",
            f"the next file after {member.name!r}",
            f"{member.limit - stop} bytes that belong to no file",
        )
    return start, stop


def directory_members(read_at: ReadAt, end: End) -> Iterator[ZipMember]:
    """Yield every member in directory order, reading the directory in pieces; each member's limit is the directory's
    start.

    Raises `truncated`, `too_large`, `encrypted`, `symlink`, `unsupported_zip`.
    """
    offset, last = end.directory_offset, end.directory_offset + end.directory_bytes
    held, at = b"", 0
    for number in range(end.entries):
        if len(held) - at < MOST_RECORD_BYTES and offset < last:
            piece = read_at(offset, min(PIECE_BYTES, last - offset))
            held, at, offset = held[at:] + piece, 0, offset + len(piece)
        if held[at : at + 4] != b"PK\1\2" or at + CENTRAL.size > len(held):
            raise ZipFaultError("truncated", f"{end.entries} directory records", f"{number}")
        fields = CENTRAL.unpack_from(held, at)
        stop = at + CENTRAL.size + sum(fields[10:13])
        if stop > len(held):
            raise ZipFaultError("truncated", f"{end.entries} directory records", f"{number} whole ones")
        yield _member(fields, held[at + CENTRAL.size : stop], end.directory_offset)
        at = stop
    if (left := len(held) - at + last - offset) > 0:
        raise ZipFaultError("unsupported_zip", "only directory records", f"{left} bytes more")


def _member(fields: tuple[int, ...], variable: bytes, limit: int) -> ZipMember:
    made_by, _, flags, method, _, _, crc32, packed, unpacked, name_bytes, extra_bytes, _, disk, _ = fields[1:15]
    attributes, at = fields[15:]
    if name_bytes > MAX_NAME_BYTES:
        raise ZipFaultError("too_large", f"names of at most {MAX_NAME_BYTES} bytes", f"{name_bytes} bytes")
    name = _decoded(variable[:name_bytes], flags)
    if flags & ENCRYPTED_FLAGS:
        raise ZipFaultError("encrypted", "plain files", f"an encrypted {name!r}")
    if method not in (STORED, DEFLATED) or disk not in (0, IN_EXTRA_16):
        raise ZipFaultError("unsupported_zip", "method 0 (store) or 8 (deflate)", f"method {method} for {name!r}")
    if made_by >> 8 in (MADE_BY_UNIX, MADE_BY_MACOS) and stat.S_ISLNK(attributes >> 16):
        raise ZipFaultError("symlink", "files", f"a symbolic link {name!r}")
    extra = extra_fields(variable[name_bytes : name_bytes + extra_bytes], name)
    check_other_name(extra, name)
    unpacked, packed, at = wide_values(extra, (unpacked, packed, at), name)
    if method == STORED and packed != unpacked:
        raise ZipFaultError("unsupported_zip", f"{unpacked} stored bytes for {name!r}", f"{packed}")
    return ZipMember(name, method, crc32, packed, unpacked, at, limit)


def _decoded(name: bytes, flags: int) -> str:
    """Decode a name as UTF-8 if announced, otherwise as code page 437, which defines all bytes."""
    try:
        return name.decode("utf-8" if flags & IN_UTF8 else "cp437")
    except UnicodeDecodeError as error:
        raise ZipFaultError("unsupported_zip", "a name in UTF-8, as the header declares", f"{name[:40]!r}") from error


def limits_of(offsets: NDArray[np.uint64], packed_bytes: NDArray[np.uint64], end: int) -> NDArray[np.int64]:
    """Return the byte (N,) before which each member must end: the start of the next, or `end`, the directory's start.

    Raises `overlapping_files`, `unsupported_zip`.
    """
    order = np.argsort(offsets, kind="stable")
    starts, sizes = offsets[order], packed_bytes[order]
    nexts = np.append(starts[1:], np.uint64(end))[: len(starts)]
    room = nexts - np.minimum(starts, nexts)
    bad = np.flatnonzero((starts > nexts) | (sizes > room) | (room - np.minimum(sizes, room) < LOCAL.size))
    if len(bad):
        at = int(bad[-1])
        raise ZipFaultError(
            "overlapping_files",
            f"the file at byte {int(starts[at])} to end before byte {int(nexts[at])}",
            f"an end after byte {int(starts[at]) + LOCAL.size + int(sizes[at])}",
        )
    first = int(starts[0]) if len(starts) else end
    if first:
        raise ZipFaultError("unsupported_zip", "the first file at byte 0", f"{first} bytes before it")
    limits = np.empty(len(order), np.int64)
    limits[order] = nexts
    return limits


# The extra fields of zip headers: zip64 sizes, and a second name that must equal the first. Fields are (tag, length,
# value) with up to three bytes of padding at the end. Source: PKWARE APPNOTE 6.3.10, §4.5.1, 4.5.3 (zip64), 4.6.9
# (Unicode path).


ZIP64_TAG, UNICODE_PATH_TAG = 0x0001, 0x7075
FIELD = struct.Struct("<2H")
BEFORE_THE_PATH = 5  # a version and the CRC-32 of the header's name


def extra_fields(extra: bytes, name: str) -> dict[int, bytes]:
    """Return the value of each tag. Raises `truncated`, or `unsupported_zip` if a known tag is repeated."""
    fields: dict[int, bytes] = {}
    at = 0
    while at + FIELD.size <= len(extra):
        tag, count = FIELD.unpack_from(extra, at)
        value = extra[at + FIELD.size : at + FIELD.size + count]
        if len(value) < count:
            raise ZipFaultError("truncated", f"an extra field of {count} bytes for {name!r}", f"{len(value)}")
        if tag in fields and tag in (ZIP64_TAG, UNICODE_PATH_TAG):
            raise ZipFaultError("unsupported_zip", f"each extra field of {name!r} only once", f"field {tag:#06x} again")
        fields[tag] = value
        at += FIELD.size + count
    return fields


def wide_values(fields: dict[int, bytes], values: tuple[int, ...], name: str) -> tuple[int, ...]:
    """Return `values` with each 0xFFFFFFFF replaced, in order, by the next 8-byte value of the zip64 field.

    Raises `truncated` if the field has too few values.
    """
    needed = sum(value == IN_EXTRA_32 for value in values)
    wide = fields.get(ZIP64_TAG, b"")
    if len(wide) < 8 * needed:
        raise ZipFaultError("truncated", f"{needed} zip64 values for {name!r}", f"{len(wide)} bytes")
    replacements = iter(struct.unpack_from(f"<{needed}Q", wide))
    return tuple(next(replacements) if value == IN_EXTRA_32 else value for value in values)


def check_other_name(fields: dict[int, bytes], name: str) -> None:
    """Raise `unsupported_zip` if a Unicode path names another file than the header: readers would differ.

    Folders may differ, because Info-ZIP writes the Unicode path if the header's encoding lacks a character.
    """
    path = fields.get(UNICODE_PATH_TAG)
    if path is not None and path[BEFORE_THE_PATH:].rpartition(b"/")[2] != name.rpartition("/")[2].encode():
        raise ZipFaultError(
            "unsupported_zip", f"one name for {name!r}", f"another name in field {UNICODE_PATH_TAG:#06x}"
        )
