"""The file of an upload: its size is the offset, its lock admits one writer.

**Conventions.** `<uploads folder>/<upload id>` contains the bytes. `<upload id>.unverified`, if it exists, contains the
first offset of a request with a checksum: bytes beyond it do not count until the checksum matches, even if the process
is killed. The lock is a `flock` on the file itself. It works between threads, processes and (on NFS with Linux ≥
2.6.12) machines, and ends with its process. A whole upload is flushed before it is accepted, and pieces every
`FLUSHED_BYTES`. A power cut therefore costs at most that many bytes, and no accepted file.
"""

import errno
import fcntl
import hashlib
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from cachetools import LRUCache

from services.runtime.settings import Settings
from services.runtime.store.free_space import NO_RESERVE, StorageFullError, require_room
from services.runtime.uploads.errors import DiskFullError, UploadLockedError

NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
MOST_PIECES = 512  # a vectored write takes 1024 (IOV_MAX)
HANDED_BYTES = 8 << 20
FLUSHED_BYTES = 64 << 20


def upload_file(settings: Settings, upload_id: str) -> Path:
    """Return the path of an upload's file."""
    return settings.uploads_folder / upload_id


def make_file(path: Path) -> None:
    """Create an empty file that survives a power cut. Raises `DiskFullError`."""
    with refusing_full(lambda: 0):
        path.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o640))
        sync_folder(path.parent)


def remove_file(path: Path) -> None:
    """Delete the file and its mark, if they exist."""
    path.unlink(missing_ok=True)
    _mark_of(path).unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def offset_of(path: Path) -> int:
    """Return the number of bytes that count. Raises `FileNotFoundError`."""
    size_bytes = path.stat().st_size
    marked = _read_mark(path)
    return size_bytes if marked is None else min(size_bytes, marked)


class LockedUploadFile:
    """An upload's file, opened and locked by this request alone (a `LockedUpload`).

    Raises `UploadLockedError` if another request has the lock, `FileNotFoundError` if there is no file.
    """

    def __init__(self, path: Path, reserve_bytes: int = NO_RESERVE) -> None:
        self.path, self._reserve_bytes = path, reserve_bytes
        self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._discard_unverified()
            self._first_byte = self._handed_bytes = self.kept_bytes
        except BlockingIOError:
            self.close()
            raise UploadLockedError(path.name) from None
        except BaseException:
            self.close()
            raise

    @property
    def kept_bytes(self) -> int:
        return os.fstat(self._descriptor).st_size

    def append(self, pieces: Sequence[bytes], offset_bytes: int) -> None:
        """Write `pieces` at `offset_bytes`, the end of the file. Raises `DiskFullError`; bytes that fitted stay.

        The kernel writes these bytes to disk early and drops them from its cache. The final flush is therefore short,
        and a bag larger than memory does not evict other files.
        """
        with refusing_full(lambda: self.kept_bytes):
            views = [memoryview(piece) for piece in pieces]
            offset_bytes = write_all(self._descriptor, views, offset_bytes, self._reserve_bytes)
        if offset_bytes - self._handed_bytes >= HANDED_BYTES:
            os.posix_fadvise(self._descriptor, self._handed_bytes, 0, os.POSIX_FADV_DONTNEED)
            self._handed_bytes = offset_bytes

    def mark_unverified(self) -> None:
        """Do not count bytes written from now on until `accept`. Raises `DiskFullError`."""
        with refusing_full(lambda: self.kept_bytes):
            _mark_of(self.path).write_text(str(self.kept_bytes), "ascii")

    def accept(self, *, is_whole: bool) -> None:
        """Count the written bytes; flush them if they end the file or if many have arrived since the last flush.

        If a power cut restores the mark, the client sends the bytes again. Raises `DiskFullError`.
        """
        self._mark_verified()
        if is_whole or self._first_byte // FLUSHED_BYTES != self.kept_bytes // FLUSHED_BYTES:
            self._sync()

    def discard(self) -> None:
        """Undo the writes of this request."""
        os.ftruncate(self._descriptor, self._first_byte)
        self._sync()  # otherwise a power cut could restore bytes without their mark
        self._mark_verified()

    def sha256(self) -> str:
        return sha256_of(self._descriptor)

    def close(self) -> None:
        """Release the lock. It may be called twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def _discard_unverified(self) -> None:
        """Discard the bytes of a request with a checksum that was killed before `accept`."""
        marked = _read_mark(self.path)
        if marked is not None and marked < self.kept_bytes:
            os.ftruncate(self._descriptor, marked)
        self._mark_verified()

    def _mark_verified(self) -> None:
        _mark_of(self.path).unlink(missing_ok=True)

    def _sync(self) -> None:
        """Flush to survive a power cut. Raises `DiskFullError` if the disk reports it only now."""
        with refusing_full(lambda: self.kept_bytes):
            os.fdatasync(self._descriptor)


def write_all(descriptor: int, pieces: Sequence[memoryview], offset_bytes: int, reserve_bytes: int) -> int:
    """Write `pieces` at `offset_bytes`; return their end. Raises `StorageFullError` before writing anything."""
    left = list(pieces)
    require_room(descriptor, sum(map(len, left)), reserve_bytes)
    while left:
        written = os.pwritev(descriptor, left[:MOST_PIECES], offset_bytes)
        offset_bytes += written
        left = _drop_written(left, written)
    return offset_bytes


@contextmanager
def refusing_full(kept_bytes: Callable[[], int]) -> Iterator[None]:
    """Raise `DiskFullError` if the disk is full, or full up to its reserve."""
    try:
        yield
    except StorageFullError as error:
        raise DiskFullError(kept_bytes(), str(error)) from error
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DiskFullError(kept_bytes()) from error
        raise


def _drop_written(views: list[memoryview], written: int) -> list[memoryview]:
    """Return the pieces after the first `written` bytes."""
    for index, view in enumerate(views):
        if written < len(view):
            return [view[written:], *views[index + 1 :]]
        written -= len(view)
    return []


def _mark_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.unverified")


def _read_mark(path: Path) -> int | None:
    with suppress(FileNotFoundError, ValueError):  # an empty mark: killed before a byte was written
        return int(_mark_of(path).read_text("ascii"))
    return None


# Rolling sha256 of uploads, so that a complete file need not be read again.
#
# **Conventions.** A process keeps a state between two consecutive requests, and takes it out to use it, so no other
# request can add to it. Without a state, the file is hashed instead. A state stays valid for the bytes below its
# offset: a request only cuts off bytes above its first offset.


PIECE_BYTES = 1 << 20


class RollingHashes:
    """Hash states of the uploads that this process received last, at most `capacity`."""

    def __init__(self, capacity: int = 1024) -> None:
        self._states: LRUCache[str, tuple[int, hashlib._Hash | None]] = LRUCache(capacity)
        self._guard = threading.Lock()

    def take(self, upload_id: str, offset_bytes: int) -> "hashlib._Hash | None":
        """Return and remove the state over the bytes [0, offset), fresh at 0; None if this process missed bytes."""
        with self._guard:
            seen_bytes, state = self._states.pop(upload_id, (0, None))
        if offset_bytes == 0:
            return hashlib.sha256()
        return state if seen_bytes == offset_bytes else None

    def keep(self, upload_id: str, offset_bytes: int, state: "hashlib._Hash") -> None:
        """Keep the state over the bytes [0, offset)."""
        with self._guard:
            self._states[upload_id] = (offset_bytes, state)


ROLLING = RollingHashes()


def sha256_of(descriptor: int) -> str:
    """Return the sha256 of an open file from its first byte, in hex."""
    state = hashlib.sha256()
    piece = bytearray(PIECE_BYTES)
    offset = 0
    while count := os.preadv(descriptor, [piece], offset):
        state.update(memoryview(piece)[:count])
        offset += count
    return state.hexdigest()
