"""A ZIP of any size, written in one pass: memory does not grow with its members.

**Conventions.** Contents that are one object are packed once. The directory waits in a second file; a member has less
than 4 GiB, the ZIP may have more.

Source: PKWARE APPNOTE 6.3.10 §4.3, §4.5.3.
"""

import shutil
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, NamedTuple

from stone_files.archives import (
    CENTRAL,
    DEFLATED,
    DOS_1980_01_01,
    FULL32,
    LOCAL,
    REGULAR_0644,
    STORED,
    UNIX,
    WITH_64,
    zip_end,
)

MOST_KEPT = 4096


class PackedMember(NamedTuple):
    """The bytes of a member as stored in the ZIP, and its facts for the headers."""

    payload: bytes
    crc32: int
    size_bytes: int


@contextmanager
def zip_stream(path: Path, *, is_deflated: bool) -> Iterator["ZipStream"]:
    """Yield the ZIP to add members to; it is complete after that."""
    with path.open("wb") as file, NamedTemporaryFile(dir=path.parent) as directory:
        stream = ZipStream(file, directory, is_deflated=is_deflated)
        yield stream
        stream.end()


class ZipStream:
    """A ZIP that is being written."""

    def __init__(self, file: IO[bytes], directory: IO[bytes], *, is_deflated: bool) -> None:
        self._file, self._directory = file, directory
        self._method, self._count, self._at = DEFLATED if is_deflated else STORED, 0, 0
        self._packed = lru_cache(MOST_KEPT)(self._pack)

    def add(self, name: str, content: bytes) -> None:
        """Add a member of bytes; equal bytes are packed only once."""
        packed = self._packed(content)
        self._file.write(self._headers(name, packed.crc32, (len(packed.payload), packed.size_bytes)))
        self._file.write(packed.payload)
        self._at = self._file.tell()

    def add_pieces(self, name: str, pieces: Iterable[bytes]) -> None:
        """Add a member of pieces, without keeping them in memory."""
        begin, crc32, size_bytes, packer = self._at, 0, 0, self._packer()
        self._file.seek(begin + LOCAL.size + len(name))
        for piece in pieces:
            crc32, size_bytes = zlib.crc32(piece, crc32), size_bytes + len(piece)
            self._file.write(packer.compress(piece) if packer else piece)
        self._file.write(packer.flush() if packer else b"")
        end = self._file.tell()
        self._file.seek(begin)
        self._file.write(self._headers(name, crc32, (end - begin - LOCAL.size - len(name), size_bytes)))
        self._at = self._file.seek(end)

    def end(self) -> None:
        """Write the directory behind the members."""
        length = self._directory.tell()
        self._directory.seek(0)
        shutil.copyfileobj(self._directory, self._file)
        self._file.write(zip_end(self._count, self._at, length))

    def _pack(self, content: bytes) -> PackedMember:
        packer = self._packer()
        payload = packer.compress(content) + packer.flush() if packer else content
        return PackedMember(payload, zlib.crc32(content), len(content))

    def _packer(self) -> "zlib._Compress | None":
        return zlib.compressobj(1, wbits=-15) if self._method == DEFLATED else None

    def _headers(self, name: str, crc32: int, sizes: tuple[int, int]) -> bytes:
        """Write the entry of the directory and return the local header of a member that starts here."""
        named = name.encode("ascii")
        extra = struct.pack("<2HQ", 1, 8, self._at) if self._at >= FULL32 else b""
        shared = (WITH_64, 0, self._method, 0, DOS_1980_01_01, crc32, *sizes, len(named))
        location = (0, 0, 0, REGULAR_0644, min(self._at, FULL32))
        entry = CENTRAL.pack(b"PK\1\2", UNIX | WITH_64, *shared, len(extra), *location)
        self._directory.write(entry + named + extra)
        self._count += 1
        return LOCAL.pack(b"PK\3\4", *shared, 0) + named
