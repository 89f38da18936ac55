"""Files of an export, read from a folder or in place from a tar archive.

**Conventions.** An `ExportFileSpan` is a byte range of a file on disk. Names are relative paths of plain parts
(`stone_files/archives.py`); other names are ignored. Sizes are checked before reading, because exports are not trusted.
"""

import os
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from stone.errors import Refused, StoneError
from stone_files.archives import NAME

PIECE_BYTES = 2**20
LONGEST_LINE_BYTES = 2**20


class DamagedExportError(StoneError):
    """A file of an export is damaged or incomplete."""

    code = "damaged_export"

    def __init__(self, path: Path, name: str, why: str) -> None:
        super().__init__(f"{path}: {name[:200]!r} cannot be read: {why}; create the export again, or download it again")
        self.why = why


class ExportContent(Protocol):
    """The bytes of one file of an export: on disk, or created from a recording when read."""

    def read(self, most_bytes: int) -> bytes:
        """Return all bytes. Raises the error of `damaged` if there are more than `most_bytes` or they cannot be
        read.
        """
        ...

    def damaged(self, why: str) -> StoneError:
        """Return the refusal of this content."""
        ...

    def identity(self) -> list[str | int]:
        """Return values that change when the bytes change."""
        ...


@dataclass(frozen=True)
class ExportFileSpan:
    """The bytes [offset, offset + size) of the file at `path`: the file `name` of an export."""

    path: Path
    name: str
    offset_bytes: int
    size_bytes: int

    def read(self, most_bytes: int) -> bytes:
        """Return all bytes. Raises `DamagedExportError` if there are more than `most_bytes`, or the file ends early."""
        if self.size_bytes > most_bytes:
            raise self.damaged(f"it has {self.size_bytes} bytes; at most {most_bytes} are expected")
        return b"".join(self.pieces())

    def part(self, start: int, most_bytes: int) -> bytes:
        """Return at most `most_bytes` bytes from `start`, fewer at the end of the file."""
        with self.path.open("rb") as file:
            wanted = max(min(most_bytes, self.size_bytes - start), 0)
            return os.pread(file.fileno(), wanted, self.offset_bytes + start)

    def lines(self) -> Iterator[bytes]:
        """Yield the lines without line ends. Raises `DamagedExportError` for a line longer than any row."""
        held = b""
        for piece in self.pieces():
            *whole, held = (held + piece).split(b"\n")
            yield from whole
            if len(held) > LONGEST_LINE_BYTES:
                raise self.damaged(f"it has a line of more than {LONGEST_LINE_BYTES} bytes")
        if held:
            yield held

    def damaged(self, why: str) -> DamagedExportError:
        return DamagedExportError(self.path, self.name, why)

    def identity(self) -> list[str | int]:
        status = self.path.stat()
        return [self.name, self.offset_bytes, self.size_bytes, status.st_mtime_ns, status.st_size]

    def pieces(self) -> Iterator[bytes]:
        """Yield the bytes in pieces. Raises `DamagedExportError` if the file ends early."""
        offset, end = self.offset_bytes, self.offset_bytes + self.size_bytes
        with self.path.open("rb") as file:
            while offset < end:
                piece = os.pread(file.fileno(), min(PIECE_BYTES, end - offset), offset)
                if not piece:
                    raise self.damaged(f"it ends {end - offset} bytes early")
                offset += len(piece)
                yield piece


class Files(Protocol):
    """The files of one export."""

    @property
    def path(self) -> Path: ...

    def span(self, name: str) -> ExportFileSpan | None:
        """Return the file with this name, or None if it does not exist or the name is invalid."""
        ...


@dataclass(frozen=True)
class FolderFiles:
    """An export in a folder."""

    path: Path

    def span(self, name: str) -> ExportFileSpan | None:
        file = self.path / name
        if not NAME.fullmatch(name) or not file.is_file():
            return None
        return ExportFileSpan(file, name, 0, file.stat().st_size)


@dataclass(frozen=True)
class TarFiles:
    """An export in a tar: the position of each file by name, below `root` (ends in a slash, or is empty)."""

    path: Path
    places: dict[str, tuple[int, int]]
    root: str = ""

    def span(self, name: str) -> ExportFileSpan | None:
        span = self.places.get(self.root + name)
        return None if span is None else ExportFileSpan(self.path, name, *span)


def frames_missing(missing: Sequence[str], sequences: Sequence[str]) -> Refused:
    return Refused(
        "frames_missing",
        f"{len(missing)} frames of the manifest have no sweep in the given exports (the first is "
        f"{missing[0]}); also give the exports of "
        f"{', '.join(sequences[:5])}{(', …' if len(sequences) > 5 else '')}",
    )


def refuse_missing(wanted: Mapping[str, Sequence[str]], found: Container[str]) -> None:
    """Raise `frames_missing` if a wanted frame token (by sequence) is not in `found`."""
    without = {name: [token for token in tokens if token not in found] for name, tokens in wanted.items()}
    missing = [token for tokens in without.values() for token in tokens]
    if missing:
        raise frames_missing(missing, [name for name, tokens in without.items() if tokens])
