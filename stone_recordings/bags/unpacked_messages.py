"""Messages that the recorder packed one by one (rosbag2's `compression_mode: message`), unpacked on reading.

**Conventions.** A CDR message starts with a zero byte, a zstd frame with 28 B5 2F FD, so every message shows whether it
is packed. A message may unpack to `MESSAGE_LIMIT_BYTES`; a declared large growth is measured before it is allocated.
"""

import cramjam
import numpy as np
import zstandard

from stone_recordings.bags.chunks import DOUBTED_RATIO, UNDOUBTED_BYTES, pieces_of
from stone_recordings.bags.errors import MalformedBagError, packed_too_large
from stone_recordings.bags.message_store import HEAD_BYTES

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MESSAGE_LIMIT_BYTES = 512 * 2**20
FRAME_HEAD_BYTES = 18  # the longest frame header that zstd writes


def is_packed(payload: memoryview) -> bool:
    return bytes(payload[:4]) == ZSTD_MAGIC


def unpacked(payload: memoryview, where: str) -> memoryview:
    """Return the message in a whole frame. Raises: MalformedBagError, `BAG-027`."""
    size_bytes = _size_of(payload, where)
    message = np.empty(size_bytes, np.uint8)
    try:
        unpacked_bytes = cramjam.zstd.decompress_into(payload, message.data)
    except cramjam.DecompressionError as error:
        raise MalformedBagError(where, f"its zstd frame cannot be decompressed ({error})") from None
    if unpacked_bytes != size_bytes:
        raise MalformedBagError(
            where, f"its zstd frame decompresses to {unpacked_bytes} bytes and declares {size_bytes}"
        )
    return message.data.toreadonly()


def unpacked_head(payload: memoryview, where: str) -> memoryview:
    """Return at least the first `HEAD_BYTES` of the message in a frame, or all of it. Raises: MalformedBagError."""
    head = next(iter(pieces_of(payload, "zstd", HEAD_BYTES)), b"")
    if not head:
        raise MalformedBagError(where, "its zstd frame cannot be decompressed")
    return memoryview(head)


def _size_of(payload: memoryview, where: str) -> int:
    """Return the declared size of the frame, or the measured one if it declares none or an implausible one."""
    try:
        declared_bytes = zstandard.get_frame_parameters(payload[:FRAME_HEAD_BYTES]).content_size
    except zstandard.ZstdError as error:
        raise MalformedBagError(where, f"its zstd frame cannot be decompressed ({error})") from None
    if declared_bytes <= max(UNDOUBTED_BYTES, DOUBTED_RATIO * len(payload)):
        return int(declared_bytes)
    size_bytes = 0
    for piece in pieces_of(payload, "zstd"):
        size_bytes += len(piece)
        if size_bytes > MESSAGE_LIMIT_BYTES:
            raise packed_too_large(where, len(payload), MESSAGE_LIMIT_BYTES)
    return size_bytes
