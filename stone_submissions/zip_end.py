"""The end record of a zip, narrow or wide: where its directory is and how many files it announces.

**Conventions.** Offsets and sizes are bytes from the start of the archive. The end record is the last thing in the file
and the directory lies right before it. Frames are archives themselves: where a zip is cut off inside of one
that is stored, the last end record is that frame's. Where there is a wide (zip64) record, the narrow one says the same,
or 0xFF….

Source: PKWARE APPNOTE 6.3.10, §4.3.14–4.3.16, 4.4.1.4.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass

from stone_submissions.errors import NotZipError, TruncatedError, UnsupportedZipError

END, END64, LOCATOR64 = struct.Struct("<4s4H2IH"), struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI")
MAX_COMMENT_BYTES = 2**16 - 1
IN_EXTRA_32, IN_EXTRA_16 = 2**32 - 1, 2**16 - 1
FIRST_FILE = b"PK\3\4"
BEFORE_ITS_SIZE = 12  # signature and size are not counted in the size of a wide record

ReadAt = Callable[[int, int], bytes]


@dataclass(frozen=True)
class End:
    """The directory as the archive's end announces it."""

    entries: int
    directory_bytes: int
    directory_offset: int


def read_end(read_at: ReadAt, size_bytes: int) -> End:
    """Raises `NotZipError`, `TruncatedError`, `UnsupportedZipError`; reads at most 66 kB."""
    tail_bytes = min(size_bytes, END.size + MAX_COMMENT_BYTES)
    tail = read_at(size_bytes - tail_bytes, tail_bytes)
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) - at < END.size:
        if _begins_as_zip(read_at):
            raise _cut_short(size_bytes)
        raise NotZipError("a zip that ends in its directory", "none" if size_bytes else "an empty file")
    _, disk, start_disk, here, entries, directory_bytes, offset, comment_bytes = END.unpack_from(tail, at)
    position = size_bytes - tail_bytes + at
    narrow = End(entries, directory_bytes, offset)
    if at + END.size + comment_bytes != len(tail):
        if _begins_as_zip(read_at) and not _may_end_at(narrow, position):
            raise _cut_short(size_bytes)
        raise NotZipError("the end record last in the file", f"{len(tail) - at - END.size - comment_bytes} bytes more")
    locator = read_at(position - LOCATOR64.size, LOCATOR64.size) if position >= LOCATOR64.size else b""
    if locator[:4] == b"PK\6\7":
        return _same(narrow, _read_wide(read_at, locator, position - LOCATOR64.size))
    return _checked(narrow, (disk, start_disk, here - entries), position)


def _begins_as_zip(read_at: ReadAt) -> bool:
    return read_at(0, len(FIRST_FILE)) == FIRST_FILE


def _may_end_at(end: End, position: int) -> bool:
    """Whether a record at byte `position` can be of this archive: those of archives inside tell of other places."""
    if IN_EXTRA_32 in (end.directory_bytes, end.directory_offset):
        return True
    return position - end.directory_offset - end.directory_bytes in (0, END64.size + LOCATOR64.size)


def _cut_short(size_bytes: int) -> TruncatedError:
    return TruncatedError("the zip's directory at its end", f"none: {size_bytes} bytes, cut off inside a file")


def _read_wide(read_at: ReadAt, locator: bytes, at: int) -> End:
    """The wide end record named by the locator at byte `at`."""
    _, disk, position, disks = LOCATOR64.unpack(locator)
    if position + END64.size > at:
        raise TruncatedError(f"a zip64 end record before byte {at}", f"one at byte {position}")
    record = read_at(position, END64.size)
    if record[:4] != b"PK\6\6":
        raise TruncatedError(f"a zip64 end record at byte {position}", "other bytes")
    _, size_bytes, _, _, own_disk, start_disk, here, entries, directory_bytes, offset = END64.unpack(record)
    if size_bytes != at - position - BEFORE_ITS_SIZE:
        raise TruncatedError(f"a zip64 end record that ends at byte {at}", f"one of {size_bytes} bytes")
    parts = (disk, own_disk, start_disk, here - entries, max(disks, 1) - 1)
    return _checked(End(entries, directory_bytes, offset), parts, position)


def _checked(end: End, parts: tuple[int, ...], position: int) -> End:
    """An end whose directory stops at byte `position`; `parts` are zeros where the archive is in one part."""
    if any(parts):
        raise UnsupportedZipError("an archive in one part", "one of several")
    if end.directory_offset + end.directory_bytes != position:
        stop = end.directory_offset + end.directory_bytes
        raise TruncatedError(f"the directory to end at byte {position}", f"its end at {stop}")
    return end


def _same(narrow: End, wide: End) -> End:
    pairs = (
        (narrow.entries, wide.entries, IN_EXTRA_16),
        (narrow.directory_bytes, wide.directory_bytes, IN_EXTRA_32),
        (narrow.directory_offset, wide.directory_offset, IN_EXTRA_32),
    )
    for said, meant, elsewhere in pairs:
        if said not in (meant, elsewhere):
            raise UnsupportedZipError(f"{meant} in both end records, as in the zip64 one", f"{said}")
    return wide
