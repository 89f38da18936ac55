"""The lock file (flock) that admits one supervisor per data folder and names it.

**Conventions.** The kernel drops the lock with the process, so nothing stale is left by `kill -9`. Children do not
inherit the descriptor.
"""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.runtime.embedded.errors import AlreadyServingError

LOCK = "server.lock"


class FolderLock:
    """The lock of a data folder, held."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def say(self, url: str) -> None:
        """Write down who holds the folder, for a second server to quote."""
        record = json.dumps({"pid": os.getpid(), "url": url}).encode()
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, record, 0)


@contextmanager
def hold_folder(folder: Path) -> Iterator[FolderLock]:
    """Hold `folder` (made where there is none, for its owner only). Raises `AlreadyServingError`."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    descriptor = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise AlreadyServingError(folder, *_holder(descriptor)) from None
        lock = FolderLock(descriptor)
        lock.say("")
        yield lock
    finally:
        os.close(descriptor)


def _holder(descriptor: int) -> tuple[int, str]:
    try:
        record = json.loads(os.pread(descriptor, 4096, 0))
        return int(record["pid"]), str(record["url"])
    except (ValueError, KeyError, TypeError):  # it is writing this very moment
        return 0, ""
