"""The source of an imported label set: the files of its scene in the release's layout, as they were published.

**Conventions.** Files lie in packs on this machine. They are a stranger's, so they are opened in a sandboxed child.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from services.runtime.store.packs import PackedFiles, read_index
from stone_exports.files import ExportFileSpan
from stone_files.archives import NAME


@dataclass(frozen=True)
class DatasetSource:
    """The index and the packs of a scene's files; a plain value, so that a child can be given it."""

    index: Path
    packs: tuple[Path, ...]

    @property
    def paths(self) -> tuple[Path, ...]:
        return (self.index, *self.packs)

    def opened(self) -> "DatasetSourceFiles":
        return DatasetSourceFiles(self.index, self.packs)


@dataclass(frozen=True, eq=False)
class DatasetSourceFiles:
    """The files of a scene by name, as those of an export (`stone_exports.files.Files`)."""

    path: Path
    packs: tuple[Path, ...]

    @cached_property
    def packed(self) -> PackedFiles:
        return read_index(self.path.read_bytes())

    def span(self, name: str) -> ExportFileSpan | None:
        at = self.packed.ordinals.get(name)
        if at is None or not NAME.fullmatch(name):
            return None
        files = self.packed
        pack = self.packs[int(files.packs[at])]
        return ExportFileSpan(pack, name, int(files.offsets_bytes[at]), int(files.sizes_bytes[at]))

    def write(self, folder: Path) -> None:
        """Write every file below the folder. Raises `DamagedExportError`."""
        for span in self._spans():
            (folder / span.name).parent.mkdir(parents=True, exist_ok=True)
            with (folder / span.name).open("wb") as file:
                for piece in span.pieces():
                    file.write(piece)

    def _spans(self) -> Iterator[ExportFileSpan]:
        return (span for name in self.packed.names if (span := self.span(name)) is not None)
