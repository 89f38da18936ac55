"""A local LRU cache of store objects that never evicts one in use.

**Conventions.** A file's modification time is the time of its last use. Files used within the last hour stay, even
above the limit: a caller may be about to open them. Unfinished downloads lie in `partial`, locked by their downloader;
if several processes need one object, the others wait for its download.
"""

import fcntl
import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from services.runtime.store.folder import refusing_full
from services.runtime.store.free_space import StorageFullError

IN_USE_S = 3600.0
MIRROR_S = 86400.0


class Cache:
    """Objects below `folder/objects`, and mirrors of runs below `folder/work` (`runtime/store/workspace.py`)."""

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self._objects = folder / "objects"
        self._partial = folder / "partial"
        self._use = folder / "use.lock"
        self.work = folder / "work"
        self._limit_bytes = limit_bytes

    def file(self, key: str, download: Callable[[str, Path], None]) -> Path:
        """Return the file of `key`; `download(key, path)` fills it if it is missing. Raises `StoreFullError`."""
        path = self._objects / key
        with refusing_full(self._objects):
            for folder in (path.parent, self._partial):
                folder.mkdir(parents=True, exist_ok=True)
            if not self._mark_used(path):
                self._fill(key, path, download)
        return path

    def forget(self, key: str) -> None:
        """Remove the file of `key`, if there is one; open readers continue."""
        with suppress(FileNotFoundError), _lock(self._use, fcntl.LOCK_EX):
            (self._objects / key).unlink()

    @contextmanager
    def borrowed(self, key: str, download: Callable[[str, Path], None]) -> Iterator[Path]:
        """Yield the file of `key`, safe from eviction; delete it afterwards unless another process borrows it."""
        while True:
            path = self.file(key, download)
            with _share_lock(path) as descriptor:
                if descriptor is None:
                    continue  # another borrower deleted it in between
                try:
                    yield path
                finally:
                    _remove_unless_borrowed(path, descriptor)
                return

    def tidy(self) -> int:
        """Delete leftovers of dead downloads and mirrors of runs unused for a day; return the number deleted."""
        removed = 0
        for partial in self._partial.iterdir() if self._partial.is_dir() else ():
            with suppress(BlockingIOError), _lock(partial, fcntl.LOCK_EX | fcntl.LOCK_NB) as descriptor:
                removed += _remove(partial, descriptor)
        for mirror in self.work.iterdir() if self.work.is_dir() else ():
            if _unused_s(mirror) > MIRROR_S:
                shutil.rmtree(mirror, ignore_errors=True)
                removed += 1
        return removed

    def _mark_used(self, path: Path) -> bool:
        """Mark the file as used, safely against eviction; return whether it exists."""
        with suppress(FileNotFoundError), _lock(self._use, fcntl.LOCK_SH):
            os.utime(path)
            return True
        return False

    def _fill(self, key: str, path: Path, download: Callable[[str, Path], None]) -> None:
        with _hold_partial(self._partial / hashlib.sha256(key.encode()).hexdigest()) as partial:
            if not self._mark_used(path):
                try:
                    download(key, partial)
                except StorageFullError:  # files unused for an hour make room
                    self._evict(0)
                    download(key, partial)
                os.replace(partial, path)
                self._evict(self._limit_bytes)

    def _evict(self, limit_bytes: int) -> None:
        files = sorted(_files(self._objects))
        total = sum(size for _, size, _ in files)
        for _, size, path in files:
            if total <= limit_bytes:
                return
            with _lock(self._use, fcntl.LOCK_EX):
                if _unused_s(path) > IN_USE_S and _evicted(path):
                    total -= size


def _files(folder: Path) -> Iterator[tuple[float, int, Path]]:
    """Yield last use, size and path of every whole file."""
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            facts = path.stat()
            if path.is_file():
                yield facts.st_mtime, facts.st_size, path


def _unused_s(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


@contextmanager
def _share_lock(path: Path) -> Iterator[int | None]:
    """Yield a descriptor with a shared lock on the file; None if the file is gone."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        yield None
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield descriptor if _is_file_of(descriptor, path) else None
    finally:
        os.close(descriptor)


def _remove_unless_borrowed(path: Path, descriptor: int) -> bool:
    with suppress(BlockingIOError):
        # Changing a lock's kind releases it for a moment, in which another process may delete or replace the file.
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return _remove(path, descriptor)
    return False


def _remove(path: Path, descriptor: int) -> bool:
    """Delete `path`, unless it is another file than that of `descriptor`, which has the exclusive lock."""
    if not _is_file_of(descriptor, path):
        return False
    path.unlink()
    return True


def _evicted(path: Path) -> bool:
    with _share_lock(path) as descriptor:
        return descriptor is None or _remove_unless_borrowed(path, descriptor)


@contextmanager
def _hold_partial(partial: Path) -> Iterator[Path]:
    """Yield `partial`, empty or half full, locked by this process alone; it is deleted afterwards."""
    while True:
        with _lock(partial, fcntl.LOCK_EX) as descriptor:
            if not _is_file_of(descriptor, partial):
                continue  # the previous holder renamed or deleted it
            try:
                yield partial
            finally:
                _remove(partial, descriptor)  # after the rename, its name belongs to the next downloader
            return


def _is_file_of(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


@contextmanager
def _lock(path: Path, operation: int) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, operation)
        yield descriptor
    finally:
        os.close(descriptor)
