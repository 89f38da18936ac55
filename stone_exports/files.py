"""Files of an export, read from a folder or in place from a tar archive.

**Conventions.** A file is a `ExportFileSpan`: bytes of some file on the disk. Names are relative paths of plain parts
(`stone_files/archives.py`); others are not seen. Whatever is read is bounded first: an export may come from
anywhere.
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
    """The bytes of one file of an export: on the disk, or made of a recording when they are read."""

    def read(self, most_bytes: int) -> bytes:
        """All of them. Raises what `damaged` gives where they are more than that, or cannot be read."""
        ...

    def damaged(self, why: str) -> StoneError:
        """The refusal of what they hold."""
        ...

    def identity(self) -> list[str | int]:
        """Facts that change when the bytes do."""
        ...


@dataclass(frozen=True)
class ExportFileSpan:
    """The bytes [offset, offset + size) of the file at `path`, which are the file `name` of an export."""

    path: Path
    name: str
    offset_bytes: int
    size_bytes: int

    def read(self, most_bytes: int) -> bytes:
        """All of it. Raises `DamagedExportError` where it is larger than that, or ends early."""
        if self.size_bytes > most_bytes:
            raise self.damaged(f"it has {self.size_bytes} bytes; at most {most_bytes} are expected")
        return b"".join(self.pieces())

    def part(self, start: int, most_bytes: int) -> bytes:
        """Its bytes from `start` on, at most so many; fewer where it ends."""
        with self.path.open("rb") as file:
            wanted = max(min(most_bytes, self.size_bytes - start), 0)
            return os.pread(file.fileno(), wanted, self.offset_bytes + start)

    def lines(self) -> Iterator[bytes]:
        """Its lines without their ends. Raises `DamagedExportError` for one longer than a row can be."""
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
        """Its bytes, a piece after the other. Raises `DamagedExportError` where it ends early."""
        place, end = self.offset_bytes, self.offset_bytes + self.size_bytes
        with self.path.open("rb") as file:
            while place < end:
                piece = os.pread(file.fileno(), min(PIECE_BYTES, end - place), place)
                if not piece:
                    raise self.damaged(f"it ends {end - place} bytes early")
                place += len(piece)
                yield piece


class Files(Protocol):
    """The files of one export."""

    @property
    def path(self) -> Path: ...

    def span(self, name: str) -> ExportFileSpan | None:
        """The file of this name; None where there is none, or no such name can be."""
        ...


@dataclass(frozen=True)
class FolderFiles:
    """An export as a folder."""

    path: Path

    def span(self, name: str) -> ExportFileSpan | None:
        file = self.path / name
        if not NAME.fullmatch(name) or not file.is_file():
            return None
        return ExportFileSpan(file, name, 0, file.stat().st_size)


@dataclass(frozen=True)
class TarFiles:
    """An export as a tar: where each file lies in it, by name below `root` (which ends in a slash, or is empty)."""

    path: Path
    places: dict[str, tuple[int, int]]
    root: str = ""

    def span(self, name: str) -> ExportFileSpan | None:
        place = self.places.get(self.root + name)
        return None if place is None else ExportFileSpan(self.path, name, *place)


# What is refused of exports as a whole.


def frames_missing(missing: Sequence[str], sequences: Sequence[str]) -> Refused:
    return Refused(
        "frames_missing",
        f"{len(missing)} frames of the manifest have no sweep in the given exports (the first is "
        f"{missing[0]}); also give the exports of "
        f"{', '.join(sequences[:5])}{(', …' if len(sequences) > 5 else '')}",
    )


def refuse_missing(wanted: Mapping[str, Sequence[str]], found: Container[str]) -> None:
    """Raises `frames_missing` where a wanted frame token, by sequence, was not found."""
    without = {name: [token for token in tokens if token not in found] for name, tokens in wanted.items()}
    missing = [token for tokens in without.values() for token in tokens]
    if missing:
        raise frames_missing(missing, [name for name, tokens in without.items() if tokens])
