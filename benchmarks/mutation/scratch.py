"""A scratch copy of a source tree in which one fault at a time is put and taken out again, with its compiled code.

**Conventions.** The checkout itself is never written. numba keeps compiled code by file and does not see that a
function inlined from another file has changed; so while a fault is in, the kept code of every module that imports the
faulty one, however far, is put aside.
"""

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.mutation.mutants import Located

INSTALLED = (".venv", "web/built", "web/node_modules")
STEP_NS = 10_000_000_000


@dataclass(frozen=True)
class Scratch:
    """The copy, and the folder of what was compiled of it."""

    root: Path
    cache: Path

    @contextlib.contextmanager
    def faulty(self, located: Located, number: int, affected: Sequence[Path]) -> Iterator[None]:
        """The fault is in the tree for as long, with a time of change of its own, so that no old bytecode is used."""
        kept, status = located.path.read_bytes(), located.path.stat()
        aside = self._put_aside(affected)
        self._mark.touch()
        try:
            located.path.write_text(located.text, "utf-8")
            os.utime(located.path, ns=(status.st_atime_ns, status.st_mtime_ns + STEP_NS * (number + 1)))
            yield
        finally:
            located.path.write_bytes(kept)
            os.utime(located.path, ns=(status.st_atime_ns, status.st_mtime_ns))
            for path in self._compiled(affected):
                path.unlink(missing_ok=True)
            for path, moved in aside:
                moved.rename(path)
            self._mark.unlink()

    def tidy(self) -> None:
        """Forget what was compiled, if a run ended while a fault was in: it may hold the fault."""
        if self._mark.exists():
            shutil.rmtree(self.cache)

    @property
    def _mark(self) -> Path:
        return self.cache / "aside" / "faulty"

    def _put_aside(self, affected: Sequence[Path]) -> list[tuple[Path, Path]]:
        folder = self.cache / "aside"
        folder.mkdir(parents=True, exist_ok=True)
        moves = [(path, folder / f"{number}-{path.name}") for number, path in enumerate(self._compiled(affected))]
        for path, moved in moves:
            path.rename(moved)
        return moves

    def _compiled(self, sources: Sequence[Path]) -> list[Path]:
        """numba's files are named `<folder>_<hash>/<module>.<function>-<line>.…`."""
        wanted = {(path.parent.name, path.stem) for path in sources}
        return [
            path
            for path in sorted(self.cache.glob("*_*/*.nb?"))
            if (path.parent.name.rpartition("_")[0], path.name.partition(".")[0]) in wanted
        ]


def copy_tree(source: Path, target: Path) -> Scratch:
    """The tracked files of a checkout, sound, and links to what is installed beside them."""
    scratch = Scratch(target / "tree", target / "cache")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=source, check=True, capture_output=True).stdout
    for name in filter(None, listed.decode().split("\0")):
        if (source / name).is_file():
            (scratch.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source / name, scratch.root / name)
    for name in INSTALLED:
        if (source / name).exists() and not (scratch.root / name).exists():
            (scratch.root / name).symlink_to((source / name).resolve())
    scratch.tidy()
    return scratch
