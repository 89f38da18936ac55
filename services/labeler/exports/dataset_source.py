"""The source of an imported label set: the published files of its scene in the release's layout.

**Conventions.** Files are in packs on this machine, or in the archive imported in place. They are untrusted, so only a
sandboxed child opens them.
"""

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.runtime.store.packs import PackedFiles, read_index
from stone_datasets.zip_files import placed_span
from stone_exports.files import ExportFileSpan
from stone_files.archives import NAME
from stone_files.byte_ranges import ByteRanges, LocalRanges
from stone_files.npz import npz_bytes


@dataclass(frozen=True)
class PlacedSource:
    """The index of files in an archive, and the archive: a path, or ranges. A plain value."""

    index: Path
    archive: Path | ByteRanges


@dataclass(frozen=True)
class DatasetSource:
    """The index and packs of a scene's files, and its files in place; a plain value for a child."""

    index: Path
    packs: tuple[Path, ...]
    placed: PlacedSource | None = None

    @property
    def paths(self) -> tuple[Path, ...]:
        """The paths of the files to open."""
        in_place = () if self.placed is None else (self.placed.index, self.placed.archive)
        return (self.index, *self.packs, *(path for path in in_place if isinstance(path, Path)))

    def opened(self) -> "DatasetSourceFiles":
        return DatasetSourceFiles(self.index, self.packs, self.placed)


@dataclass(frozen=True, eq=False)
class DatasetSourceFiles:
    """The files of a scene by name, like those of an export (`stone_exports.files.Files`)."""

    path: Path
    packs: tuple[Path, ...]
    placed: PlacedSource | None = None

    @cached_property
    def packed(self) -> PackedFiles:
        return read_index(self.path.read_bytes())

    def span(self, name: str) -> ExportFileSpan | None:
        at = self.packed.ordinals.get(name)
        if not NAME.fullmatch(name):
            return None
        if at is None:
            return self._placed_span(name)
        files = self.packed
        pack = self.packs[int(files.packs[at])]
        return ExportFileSpan(pack, name, int(files.offsets_bytes[at]), int(files.sizes_bytes[at]))

    def write(self, folder: Path) -> None:
        """Write every file to the folder. Raises `DamagedExportError`."""
        for span in self._spans():
            (folder / span.name).parent.mkdir(parents=True, exist_ok=True)
            with (folder / span.name).open("wb") as file:
                for piece in span.pieces():
                    file.write(piece)

    def _spans(self) -> Iterator[ExportFileSpan]:
        names = (*self.packed.names, *self._in_place)
        return (span for name in names if (span := self.span(name)) is not None)

    def _placed_span(self, name: str) -> ExportFileSpan | None:
        at = self._in_place.get(name)
        if at is None or self.placed is None:
            return None
        archive = self.placed.archive
        ranges = LocalRanges(archive) if isinstance(archive, Path) else archive
        return placed_span(ranges, (name, self._index.held[at]), self._index.places[at])

    @cached_property
    def _in_place(self) -> Mapping[str, int]:
        """The index position of each file that is in the archive."""
        return {} if self.placed is None else {name: at for at, name in enumerate(self._index.names)}

    @cached_property
    def _index(self) -> "PlacedFiles":
        return read_placed(self.placed.index.read_bytes() if self.placed else b"")


@dataclass(frozen=True, eq=False)
class PlacedFiles:
    """N files of a scene in an archive, by name.

    `places` (N, 6) is as in `PLACE` of `stone_datasets/zip_files.py`.
    """

    names: tuple[str, ...]
    held: tuple[str, ...]
    places: NDArray[np.int64]


def placed_bytes(files: PlacedFiles) -> bytes:
    """Return the index as a file; equal files give equal bytes."""
    return npz_bytes({"names": joined_names(files.names), "held": joined_names(files.held), "places": files.places})


def read_placed(payload: bytes) -> PlacedFiles:
    """Return the files from an index by `placed_bytes`. Raises ValueError if it is truncated."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        names, held, places = parted_names(arrays["names"]), parted_names(arrays["held"]), arrays["places"]
    return PlacedFiles(names, held, places.astype(np.int64))


def joined_names(names: tuple[str, ...]) -> NDArray[np.uint8]:
    """Return the names as an array of bytes."""
    return np.frombuffer("\n".join((str(len(names)), *names)).encode("ascii"), np.uint8)


def parted_names(joined: NDArray[np.uint8]) -> tuple[str, ...]:
    """Return the names joined by `joined_names`. Raises ValueError if the array is truncated."""
    count, *names = joined.tobytes().decode("ascii").split("\n")
    if int(count) != len(names):
        raise ValueError("a list of names is truncated")
    return tuple(names)
