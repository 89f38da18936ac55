"""A file that the recorder compressed as a whole (rosbag2's `compression_mode: file`), unpacked into a folder of ours.

**Conventions.** Names lose their last suffix: `run_0.db3.zstd` → `run_0.db3`. What grows beyond `RATIO_LIMIT` times its
packed size, or would fill the disk, is refused while it is unpacked.
"""

from collections.abc import Iterator
from pathlib import Path

import zstandard

from stone_recordings.bags.errors import MalformedBagError, PackedTooLargeError
from stone_recordings.bags.private_folder import PrivateFolder

RATIO_LIMIT = 100
SMALL_BYTES = 64 * 2**20
WINDOW_LIMIT_BYTES = 128 * 2**20  # zstd -19 --long=27, the most that zstd itself unpacks unasked
PIECE_BYTES = 4 * 2**20


def first_bytes(path: Path, size_bytes: int) -> bytes:
    """The first bytes of what is packed; b"" where it does not unpack."""
    codec = zstandard.ZstdDecompressor(max_window_size=WINDOW_LIMIT_BYTES)
    try:
        with path.open("rb") as file, codec.stream_reader(file) as stream:
            return bytes(stream.read(size_bytes))
    except zstandard.ZstdError:
        return b""


def unpacked_file(path: Path, folder: PrivateFolder) -> Path:
    """The file in `folder`; of one that was cut off, what came out before the cut.

    Raises: MalformedBagError (damaged), PackedTooLargeError, NoRoomError.
    """
    packed_bytes = path.stat().st_size
    limit_bytes = max(SMALL_BYTES, RATIO_LIMIT * packed_bytes)
    target, size_bytes = folder.path / path.stem, 0
    with target.open("wb") as file:
        for piece in _pieces(path):
            size_bytes += len(piece)
            if size_bytes > limit_bytes:
                raise PackedTooLargeError(path.name, packed_bytes, limit_bytes)
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
