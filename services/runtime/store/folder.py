"""A store in a local folder: an object is a file whose path is its key.

**Conventions.** Bytes are staged in `.staging` of the same folder, flushed, and renamed into place. The folders above
are flushed too, so an object that a row names survives a power cut. `tidy` deletes the leftovers of `kill -9` in
`.staging`: each writer holds a `flock` on its staging, so no clock decides its ownership.
"""

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

from services.runtime.store.free_space import NO_RESERVE, require_room
from services.runtime.store.keys import (
    ObjectMissingError,
    StoreFullError,
    checked,
    checked_prefix,
    checked_range,
    is_key,
)
from services.runtime.store.protocol import StoredObject
from services.runtime.telemetry.counters import STORE_BYTES, process_counters
from stone_files.atomic import flush

PIECE_BYTES = 2**20
SMALL_BYTES = 2**16
NO_LINK = {errno.EEXIST, errno.EXDEV, errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP, errno.ENOSYS}
NO_SPACE = {errno.ENOSPC, errno.EDQUOT}


class FolderStore:
    """Objects below `root`; an object of more than `SMALL_BYTES` leaves `reserve_bytes` of its disk free."""

    def __init__(self, root: Path, reserve_bytes: int = NO_RESERVE) -> None:
        self.root, self._reserve_bytes = root, reserve_bytes
        self._staging = root / ".staging"

    def write(self, key: str, source: Path) -> None:
        """Store a copy of `source`. Raises `StoreFullError`, leaving nothing behind."""
        target = self.root / checked(key)
        if (size_bytes := source.stat().st_size) > SMALL_BYTES:
            require_room(self.root, size_bytes, self._reserve_bytes)
        with refusing_full(self.root), self._staged() as staging:
            shutil.copyfile(source, staging)
            flush(staging)
            size_bytes = staging.stat().st_size
            _place(lambda: os.replace(staging, target), staging, target)
        process_counters().add(STORE_BYTES, ("in",), size_bytes)

    def adopt(self, key: str, source: Path) -> None:
        """Store `source` by a hard link if the filesystem allows it, else as a copy; `source` stays."""
        target = self.root / checked(key)
        flush(source)
        os.utime(source)  # the object is new even if the file is old: its age must not make it look abandoned
        try:
            with refusing_full(self.root):
                _place(lambda: os.link(source, target), source, target)
            process_counters().add(STORE_BYTES, ("in",), source.stat().st_size)
        except OSError as error:
            if error.errno not in NO_LINK:
                raise
            self.write(key, source)

    def read(self, key: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Yield the bytes [start, stop), clipped to the object, in pieces; a missing object raises at the call."""
        checked_range(start, stop)
        end = self.size_bytes(key)
        return self._pieces(key, start, end if stop is None else min(stop, end))

    def size_bytes(self, key: str) -> int:
        return self.local(key).stat().st_size

    def local(self, key: str) -> Path:
        path = self.root / checked(key)
        if not path.is_file():
            raise ObjectMissingError(key)
        return path

    def forget_copy(self, key: str) -> None:
        """Do nothing: the file is the object."""

    def delete(self, key: str) -> None:
        path = self.root / checked(key)
        path.unlink(missing_ok=True)
        with suppress(OSError):  # remove the folders above with their last object; a writer creates them again
            for folder in list(path.relative_to(self.root).parents)[:-2]:
                (self.root / folder).rmdir()

    def listed(self, prefix: str) -> Iterator[StoredObject]:
        """Yield objects in the order of their keys; objects added or deleted meanwhile may be missed."""
        folder, _, _ = checked_prefix(prefix).rpartition("/")
        yield from self._walk(folder, prefix)

    def tidy(self, grace_s: float) -> int:
        """Delete leftovers of dead writers; return their number. The grace is not needed here."""
        removed = 0
        for entry in self._staging.iterdir() if self._staging.is_dir() else ():
            with suppress(FileNotFoundError):
                removed += _removed_if_dead(entry)
        return removed

    def _pieces(self, key: str, start: int, stop: int) -> Iterator[bytes]:
        with self.local(key).open("rb") as file:
            file.seek(start)
            while start < stop and (piece := file.read(min(PIECE_BYTES, stop - start))):
                start += len(piece)
                process_counters().add(STORE_BYTES, ("out",), len(piece))
                yield piece

    def _walk(self, folder: str, prefix: str) -> Iterator[StoredObject]:
        try:
            with os.scandir(self.root / folder) as scan:
                entries = [entry for entry in scan if not entry.name.startswith(".")]
        except (FileNotFoundError, NotADirectoryError):
            return
        for entry in sorted(entries, key=_place_in_order):
            path = f"{folder}/{entry.name}".lstrip("/")
            if entry.is_dir(follow_symlinks=False):
                if f"{path}/".startswith(prefix) or prefix.startswith(f"{path}/"):
                    yield from self._walk(path, prefix)
            elif path.startswith(prefix) and is_key(path):
                with suppress(FileNotFoundError):
                    facts = entry.stat(follow_symlinks=False)
                    yield StoredObject(path, facts.st_size, facts.st_mtime_ns)

    @contextmanager
    def _staged(self) -> Iterator[Path]:
        make_folder(self._staging)
        staging, descriptor = _make_locked(self._staging)
        try:
            yield staging
        finally:
            staging.unlink(missing_ok=True)
            os.close(descriptor)


def _make_locked(folder: Path) -> tuple[Path, int]:
    """Return a new folder and a descriptor that locks it; retry if `tidy` deleted the folder before the lock."""
    while True:
        staging = folder / f"{token_hex(8)}.partial"
        descriptor = os.open(staging, os.O_CREAT | os.O_EXCL | os.O_RDONLY, 0o644)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        if staging.exists():
            return staging, descriptor
        os.close(descriptor)


def _place(move: Callable[[], None], source: Path, target: Path) -> None:
    """Move or link into place; retry if a deletion removed the empty folder in between."""
    while True:
        make_folder(target.parent)
        try:
            move()
            break
        except FileNotFoundError:
            source.stat()  # raises if the source is gone
    flush(target.parent)


def make_folder(folder: Path) -> None:
    """Create `folder` and its parents so that they survive a power cut."""
    missing = [path for path in (folder, *folder.parents) if not path.is_dir()]
    for path in reversed(missing):
        with suppress(FileExistsError, FileNotFoundError):
            path.mkdir()
            flush(path.parent)


@contextmanager
def refusing_full(place: Path) -> Iterator[None]:
    """Raise `StoreFullError` instead of the operating system's full-disk error."""
    try:
        yield
    except OSError as error:
        if error.errno in NO_SPACE:
            raise StoreFullError(place) from error
        raise


def _place_in_order(entry: os.DirEntry[str]) -> str:
    return f"{entry.name}/" if entry.is_dir(follow_symlinks=False) else entry.name


def _removed_if_dead(entry: Path) -> bool:
    descriptor = os.open(entry, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        entry.unlink()
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True
