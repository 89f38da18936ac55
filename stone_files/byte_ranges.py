"""Byte ranges of an archive that is read in place: in a local file, or at a URL."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol


class ByteRanges(Protocol):
    """The bytes of one archive; messages name it by `path`."""

    @property
    def path(self) -> Path: ...

    @property
    def size_bytes(self) -> int: ...

    def read_at(self, offset: int, count: int) -> bytes:
        """Return `count` bytes from `offset`, or fewer at the end of the archive."""
        ...

    def identity(self) -> list[str | int]:
        """Return values that change when the bytes change."""
        ...


@dataclass(frozen=True)
class LocalRanges:
    """The bytes of a local file."""

    path: Path

    @cached_property
    def size_bytes(self) -> int:
        return self.path.stat().st_size

    def read_at(self, offset: int, count: int) -> bytes:
        with self.path.open("rb", buffering=0) as file:
            return os.pread(file.fileno(), count, offset)

    def identity(self) -> list[str | int]:
        status = self.path.stat()
        return [str(self.path), status.st_mtime_ns, status.st_size]
