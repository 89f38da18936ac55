"""Limits on the total contents of a sandboxed child's folder: files and folders, bytes, depth.

**Conventions.** The kernel limits the size of each file of a child but not their number, so its parent checks the
folder. It does so every `PAUSE_S`, less often if a check takes long, and once more when the work is done. It counts the
folder's disk usage (blocks, not lengths), by any owner. It also counts files that the child holds open without a name,
if their descriptors are readable. Between two checks only the speed of the disk limits the child's writes.
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
LOOKING_SHARE = 50  # after a check of 1 s, the next one comes 50 s later
DEEPEST = 64
BLOCK_BYTES = 512


@dataclass
class FolderWatch:
    """The limits of one child's folder, and the time of the next check."""

    limits: SandboxLimits
    _next_s: float = field(default_factory=lambda: time.monotonic() + PAUSE_S)

    def look_at_times(self, pid: int) -> None:
        """Call `look` if the next check is due."""
        begun_s = time.monotonic()
        if begun_s >= self._next_s:
            self.look(pid)
            now_s = time.monotonic()
            self._next_s = now_s + max(PAUSE_S, LOOKING_SHARE * (now_s - begun_s))

    def look(self, pid: int) -> None:
        """Raise `SandboxCrashedError` if the folder, with the open files of the child `pid`, exceeds its limits."""
        if self.limits.folder is None:
            return
        held_bytes = 0
        for files, facts in enumerate(_walk(self.limits.folder, pid), start=1):
            held_bytes += facts.st_blocks * BLOCK_BYTES
            if files > self.limits.folder_files:
                raise SandboxCrashedError(f"left more than {self.limits.folder_files} files and folders")
            if held_bytes > self.limits.folder_bytes:
                raise SandboxCrashedError(f"left more than {self.limits.folder_bytes} bytes in its files")


def _walk(folder: Path, pid: int) -> Iterator[os.stat_result]:
    """Yield every entry below the folder once, then the files that the process holds open without a name."""
    for directory, folders, files, descriptor in os.fwalk(folder, onerror=_refuse_unreadable):
        if len(Path(directory).relative_to(folder).parts) >= DEEPEST:
            raise SandboxCrashedError(f"left nested folders, {DEEPEST} deep")
        for name in (*folders, *files):
            with suppress(FileNotFoundError):
                yield os.stat(name, dir_fd=descriptor, follow_symlinks=False)
    yield from _list_nameless(os.stat(folder).st_dev, pid)


def _list_nameless(device: int, pid: int) -> Iterator[os.stat_result]:
    """Yield the files without a name on the device that the process holds open, except its logs."""
    logs = [os.fstat(number) for number in (1, 2)]
    with suppress(OSError):
        for number in os.listdir(f"/proc/{pid}/fd"):
            with suppress(OSError):
                held = os.stat(f"/proc/{pid}/fd/{number}")
                is_nameless = stat.S_ISREG(held.st_mode) and held.st_nlink == 0 and held.st_dev == device
                if is_nameless and not any(os.path.samestat(held, log) for log in logs):
                    yield held


def _refuse_unreadable(error: OSError) -> None:
    """Ignore a deleted folder. Raises `SandboxCrashedError` for an unreadable folder, which may contain anything."""
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise SandboxCrashedError("left an unreadable folder") from error


def give_back(folder: Path) -> None:
    """Make this process's user the owner of files in the folder that belong to a child's own user."""
    if os.geteuid() != 0:
        return
    for _, folders, files, descriptor in os.fwalk(folder):
        for name in (*folders, *files):
            with suppress(FileNotFoundError):
                if os.stat(name, dir_fd=descriptor, follow_symlinks=False).st_uid >= NOBODY_ELSE:
                    os.chown(name, 0, os.getegid(), dir_fd=descriptor, follow_symlinks=False)
