"""How much a sandboxed child may leave in its folder in all: files and folders, bytes, depth.

**Conventions.** The kernel bounds each file of a child and not how many there are, so its parent looks: again after
`PAUSE_S`, or later if looking takes long, and once more when the work is done. What is counted is what the folder takes
on the disk (blocks, not lengths), whoever made it, and files that the child holds open without a name, if their
descriptors can be looked at. What a child writes between two looks is bounded by how fast it writes.
"""

import os
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from services.runtime.sandbox.errors import SandboxCrashedError
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.own_user import NOBODY_ELSE

PAUSE_S = 2.0
LOOKING_SHARE = 50  # a look that took a second is followed by fifty without one
DEEPEST = 64
BLOCK_BYTES = 512


@dataclass
class FolderWatch:
    """The bounds of one child's folder, and when they are looked at next."""

    limits: SandboxLimits
    _next_s: float = field(default_factory=lambda: time.monotonic() + PAUSE_S)

    def look_at_times(self, pid: int) -> None:
        """As `look`, if it is time to."""
        begun_s = time.monotonic()
        if begun_s >= self._next_s:
            self.look(pid)
            now_s = time.monotonic()
            self._next_s = now_s + max(PAUSE_S, LOOKING_SHARE * (now_s - begun_s))

    def look(self, pid: int) -> None:
        """Raises `SandboxCrashedError` if the folder, and what the child `pid` holds open, is more than it may be."""
        if self.limits.folder is None:
            return
        held_bytes = 0
        for files, found in enumerate(_found(self.limits.folder, pid), start=1):
            held_bytes += found.st_blocks * BLOCK_BYTES
            if files > self.limits.folder_files:
                raise SandboxCrashedError(f"left more than {self.limits.folder_files} files and folders")
            if held_bytes > self.limits.folder_bytes:
                raise SandboxCrashedError(f"left more than {self.limits.folder_bytes} bytes in its files")


def _found(folder: Path, pid: int) -> Iterator[os.stat_result]:
    """Yield what is below the folder, each but once, then what the process holds open without a name."""
    for place, folders, files, descriptor in os.fwalk(folder, onerror=_unseen):
        if len(Path(place).relative_to(folder).parts) >= DEEPEST:
            raise SandboxCrashedError(f"left folders in each other, {DEEPEST} deep")
        for name in (*folders, *files):
            with suppress(FileNotFoundError):
                yield os.stat(name, dir_fd=descriptor, follow_symlinks=False)
    yield from _nameless(os.stat(folder).st_dev, pid)


def _nameless(device: int, pid: int) -> Iterator[os.stat_result]:
    """Yield the files without a name on the device that the process holds open, but for where it logs to."""
    logs = [os.fstat(number) for number in (1, 2)]
    with suppress(OSError):
        for number in os.listdir(f"/proc/{pid}/fd"):
            with suppress(OSError):
                held = os.stat(f"/proc/{pid}/fd/{number}")
                is_nameless = stat.S_ISREG(held.st_mode) and held.st_nlink == 0 and held.st_dev == device
                if is_nameless and not any(os.path.samestat(held, log) for log in logs):
                    yield held


def _unseen(error: OSError) -> None:
    """A folder that is gone holds nothing; one that is shut may hold anything."""
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise SandboxCrashedError("left a folder that nobody can look into") from error


def give_back(folder: Path) -> None:
    """Make this process's user the owner of what a child with a user of its own left in the folder."""
    if os.geteuid() != 0:
        return
    for _, folders, files, descriptor in os.fwalk(folder):
        for name in (*folders, *files):
            with suppress(FileNotFoundError):
                if os.stat(name, dir_fd=descriptor, follow_symlinks=False).st_uid >= NOBODY_ELSE:
                    os.chown(name, 0, os.getegid(), dir_fd=descriptor, follow_symlinks=False)
