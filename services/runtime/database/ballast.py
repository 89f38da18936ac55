"""The ballast: a file beside SQLite that is deleted on a full disk, so that rows that free space can be written.

**Conventions.** It is created if it fits beside the reserve (`services/runtime/store/free_space.py`): when the platform
starts, and again by the sweeper. Only requests delete it, because users sign in, delete, cancel and deactivate accounts
by requests; workers and the sweeper never do.
"""

import os
from pathlib import Path

from sqlalchemy.exc import OperationalError

from services.runtime.settings import Settings
from services.runtime.store.free_space import free_space

NAME = "ballast"
MOST_BYTES = 64 << 20


class Ballast:
    """The ballast of a data folder: `MOST_BYTES`, but at most the reserve."""

    def __init__(self, settings: Settings) -> None:
        self.path: Path = settings.root / NAME
        self._reserve_bytes = settings.store.reserve_bytes
        self._low_bytes = self._size_bytes() // 2

    def make(self) -> bool:
        """Create the file if it is missing and fits beside the reserve; return whether it exists."""
        if self.path.exists():
            return True
        size_bytes = self._size_bytes()
        if not free_space(self.path.parent, self._reserve_bytes).takes(size_bytes):
            return False
        staging = self.path.with_name(f".{NAME}")
        descriptor = os.open(staging, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size_bytes)
        except OSError:
            staging.unlink(missing_ok=True)
            return False
        finally:
            os.close(descriptor)
        staging.replace(self.path)
        return True

    def give_up_if_low(self) -> None:
        """Delete the file if less than half of its size is free, before the next rows are written."""
        if free_space(self.path.parent).free_bytes < self._low_bytes:
            self.give_up()

    def give_up(self) -> None:
        self.path.unlink(missing_ok=True)

    def _size_bytes(self) -> int:
        return min(MOST_BYTES, free_space(self.path.parent, self._reserve_bytes).reserve_bytes)


def is_full(error: OperationalError) -> bool:
    """Return whether SQLite failed because the disk is full."""
    return "disk is full" in str(error)
