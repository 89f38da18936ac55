"""A private folder for data that must be unpacked or copied before reading, removed on closing.

**Conventions.** Under the system's folder for temporary files (`TMPDIR`), readable by our user alone. It is removed
when it is closed or collected, or when the process that created it ends; a forked child that inherits it never removes
it.
"""

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path

import zstandard

from stone_recordings.bags.errors import MalformedBagError, NoRoomError, packed_too_large

# The space that a temporary copy must leave free on its disk.
SPARED_BYTES = 256 * 2**20


class PrivateFolder:
    """A fresh folder at `path`."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="stone-bag-"))
        self._finalizer = weakref.finalize(self, _remove, self.path, os.getpid())

    def close(self) -> None:
        self._finalizer()

    def close_with(self, owner: object) -> None:
        """Close when `owner` is collected: its maps and open files stay readable until then."""
        self._finalizer.detach()
        weakref.finalize(owner, _remove, self.path, os.getpid())

    def link_or_copy(self, source: Path) -> Path:
        """Return `source` under its own name: a hard link if the disk allows it (never write to it!), else a copy."""
        target = self.path / source.name
        try:
            os.link(source.resolve(), target)
        except OSError:  # another disk, or a file of another user
            self.copy(source)
        return target

    def copy(self, source: Path) -> Path:
        """Return a writable copy of `source` under its own name. Raises: NoRoomError."""
        target = self.path / source.name
        self.check_room(source.name, source.stat().st_size)
        shutil.copyfile(source, target)
        return target

    def check_room(self, name: str, size_bytes: int) -> None:
        """Raise NoRoomError (BAG-028) if `size_bytes` more would fill the disk."""
        free_bytes = shutil.disk_usage(self.path).free
        if size_bytes + SPARED_BYTES > free_bytes:
            raise NoRoomError(name, size_bytes, free_bytes)


def _remove(path: Path, pid: int) -> None:
    if os.getpid() == pid:
        shutil.rmtree(path, ignore_errors=True)


# A file that the recorder compressed as a whole (rosbag2's `compression_mode: file`), unpacked into a private folder.
# Names lose their last suffix: `run_0.db3.zstd` → `run_0.db3`. If the data grows beyond `RATIO_LIMIT` times its packed
# size, or would fill the disk, unpacking stops with a refusal.


RATIO_LIMIT = 100
SMALL_BYTES = 64 * 2**20
WINDOW_LIMIT_BYTES = 128 * 2**20  # zstd -19 --long=27, the largest window that zstd unpacks by default
PIECE_BYTES = 4 * 2**20


def first_bytes(path: Path, size_bytes: int) -> bytes:
    """Return the first unpacked bytes; b"" if the file does not unpack."""
    codec = zstandard.ZstdDecompressor(max_window_size=WINDOW_LIMIT_BYTES)
    try:
        with path.open("rb") as file, codec.stream_reader(file) as stream:
            return bytes(stream.read(size_bytes))
    except zstandard.ZstdError:
        return b""


def unpacked_file(path: Path, folder: PrivateFolder) -> Path:
    """Return the unpacked file in `folder`; for a cut file the part before the cut.

    Raises: MalformedBagError (damaged), `BAG-027`, NoRoomError.
    """
    packed_bytes = path.stat().st_size
    limit_bytes = max(SMALL_BYTES, RATIO_LIMIT * packed_bytes)
    target, size_bytes = folder.path / path.stem, 0
    with target.open("wb") as file:
        for piece in _pieces(path):
            size_bytes += len(piece)
            if size_bytes > limit_bytes:
                raise packed_too_large(path.name, packed_bytes, limit_bytes)
            folder.check_room(path.name, len(piece))
            file.write(piece)
    return target


def _pieces(path: Path) -> Iterator[bytes]:
    codec = zstandard.ZstdDecompressor(max_window_size=WINDOW_LIMIT_BYTES)
    try:
        with path.open("rb") as file, codec.stream_reader(file, read_across_frames=True) as stream:
            while piece := stream.read(PIECE_BYTES):
                yield piece
    except zstandard.ZstdError as error:
        raise MalformedBagError(path.name, f"its zstd data cannot be decompressed ({error})") from None
