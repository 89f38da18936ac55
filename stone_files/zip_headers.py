"""Zip headers for stored entries, with zip64 fields only where needed.

**Conventions.** CRC and sizes are known beforehand, so no data descriptors; names are ASCII; every file is 0644, of
1980-01-01. An entry's `offset_bytes` is where its local header begins.

Source: PKWARE APPNOTE 6.3.10 §4.3.7 (local), §4.3.12 (central), §4.3.14 to 16 (end), §4.5.3 (zip64 extra).
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FULL32, FULL16 = 0xFFFFFFFF, 0xFFFF
PLAIN, WITH_64 = 20, 45
UNIX, REGULAR_0644 = 3 << 8, 0o100644 << 16
DOS_1980_01_01 = 0x0021
LOCAL, CENTRAL = struct.Struct("<4s5H3I2H"), struct.Struct("<4s6H3I5H2I")
END, END_64, LOCATOR = struct.Struct("<4s4H2IH"), struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI")


@dataclass(frozen=True)
class ZipEntry:
    """A stored file."""

    name: str
    size_bytes: int
    crc32: int
    offset_bytes: int = 0


def local_bytes(names: NDArray[np.int64], sizes_bytes: NDArray[np.int64]) -> NDArray[np.int64]:
    """The lengths of local headers, for names of these lengths."""
    return np.asarray(LOCAL.size + names + 20 * (sizes_bytes >= FULL32), np.int64)


def central_bytes(
    names: NDArray[np.int64], sizes_bytes: NDArray[np.int64], offsets: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The lengths of entries of the central directory."""
    is_large, is_far = sizes_bytes >= FULL32, offsets >= FULL32
    return np.asarray(CENTRAL.size + names + 4 * (is_large | is_far) + 16 * is_large + 8 * is_far, np.int64)


def end_bytes(count: int, begin: int, length: int) -> int:
    """The length of `zip_end(count, begin, length)`."""
    return END.size + (END_64.size + LOCATOR.size if _needs_64(count, begin, length) else 0)


def zip_local(entry: ZipEntry) -> bytes:
    """What stands before the content."""
    extra = _extra(entry.size_bytes, entry.size_bytes) if entry.size_bytes >= FULL32 else b""
    return LOCAL.pack(b"PK\3\4", *_described(entry, extra)) + entry.name.encode("ascii") + extra


def zip_central(entry: ZipEntry) -> bytes:
    """The entry of the central directory."""
    sizes = (entry.size_bytes, entry.size_bytes) if entry.size_bytes >= FULL32 else ()
    far = (entry.offset_bytes,) if entry.offset_bytes >= FULL32 else ()
    extra = _extra(*sizes, *far) if sizes or far else b""
    place = (0, 0, 0, REGULAR_0644, min(entry.offset_bytes, FULL32))
    version = _version(extra)
    head = CENTRAL.pack(b"PK\1\2", UNIX | version, *_described(entry, extra), *place)
    return head + entry.name.encode("ascii") + extra


def zip_end(count: int, begin: int, length: int) -> bytes:
    """What stands behind the central directory, which begins at `begin` and has `length` bytes."""
    plain = (min(count, FULL16), min(count, FULL16), min(length, FULL32), min(begin, FULL32))
    end = END.pack(b"PK\5\6", 0, 0, *plain, 0)
    if not _needs_64(count, begin, length):
        return end
    whole = END_64.pack(b"PK\6\6", END_64.size - 12, UNIX | WITH_64, WITH_64, 0, 0, count, count, length, begin)
    return whole + LOCATOR.pack(b"PK\6\7", 0, begin + length, 1) + end


def _described(entry: ZipEntry, extra: bytes) -> tuple[int, ...]:
    """What local header and central entry say alike."""
    size = min(entry.size_bytes, FULL32)
    stamp = (0, DOS_1980_01_01)
    return (_version(extra), 0, 0, *stamp, entry.crc32, size, size, len(entry.name), len(extra))


def _extra(*values: int) -> bytes:
    return struct.pack(f"<2H{len(values)}Q", 1, 8 * len(values), *values)


def _version(extra: bytes) -> int:
    return WITH_64 if extra else PLAIN


def _needs_64(count: int, begin: int, length: int) -> bool:
    return count >= FULL16 or begin >= FULL32 or length >= FULL32
