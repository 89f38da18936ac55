"""A folder of our own for what must be unpacked or copied before it can be read, gone when it is closed.

**Conventions.** Under the system's folder for temporary files (`TMPDIR`), readable by us alone. It goes when it is
closed, collected, or when the process that made it ends; a forked child that inherits it never removes it.
"""

import os
import shutil
import tempfile
import weakref
from pathlib import Path

from stone_recordings.bags.errors import NoRoomError

# What a temporary copy must leave free on its disk.
SPARED_BYTES = 256 * 2**20


class PrivateFolder:
    """A fresh folder; `path` is where."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="stone-bag-"))
        self._finalizer = weakref.finalize(self, _remove, self.path, os.getpid())

    def close(self) -> None:
        self._finalizer()

    def close_with(self, owner: object) -> None:
        """Go when `owner` is collected: what it has mapped or opened stays readable until then."""
        self._finalizer.detach()
        weakref.finalize(owner, _remove, self.path, os.getpid())

    def link_or_copy(self, source: Path) -> Path:
        """`source` under its own name: the same file where the disk allows (never write to it!), else a copy."""
        target = self.path / source.name
        try:
            os.link(source.resolve(), target)
        except OSError:  # another disk, or somebody else's file
            self.copy(source)
        return target

    def copy(self, source: Path) -> Path:
        """`source` under its own name, ours to write. Raises: NoRoomError."""
        target = self.path / source.name
        self.check_room(source.name, source.stat().st_size)
        shutil.copyfile(source, target)
        return target

    def check_room(self, name: str, size_bytes: int) -> None:
        """Raises: NoRoomError (BAG-028) where `size_bytes` more would fill the disk."""
        free_bytes = shutil.disk_usage(self.path).free
        if size_bytes + SPARED_BYTES > free_bytes:
            raise NoRoomError(name, size_bytes, free_bytes)


def _remove(path: Path, pid: int) -> None:
    if os.getpid() == pid:
        shutil.rmtree(path, ignore_errors=True)
