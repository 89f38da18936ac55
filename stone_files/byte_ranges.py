"""Bytes of an archive that are read where they lie, by ranges: in a local file, or behind an address."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol


class ByteRanges(Protocol):
    """The bytes of one archive. `path` is its name in messages."""

    @property
    def path(self) -> Path: ...

    @property
    def size_bytes(self) -> int: ...

    def read_at(self, offset: int, count: int) -> bytes:
        """Return the bytes from `offset` on, `count` of them; fewer if the archive ends."""
        ...

    def identity(self) -> list[str | int]:
        """Return facts that change when the bytes do."""
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
