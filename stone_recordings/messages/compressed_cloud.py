"""The PointCloud2 that a CompressedPointCloud2 of point_cloud_transport was made of.

**Conventions.** The two messages are alike up to the points, so what a PointCloud2 is checked for holds for both. The
formats "zlib" (a stream with a zlib or gzip header) and "zstd" keep every byte; the others are refused by name. No more
is inflated than the declared size of the cloud. Source: point_cloud_interfaces, point_cloud_transport_plugins.
"""

import struct
import zlib
from collections.abc import Callable, Mapping

import zstandard

from stone_recordings.bags.errors import IngestError, MessageLayoutError
from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD
from stone_recordings.messages.pointcloud2 import CloudSize, cloud_size, layout_problem
from stone_recordings.messages.types.cdr import Cursor

# A revolution of 2.6 million points of 26 bytes; no LiDAR is near that.
MOST_CLOUD_BYTES = 64 << 20
ANY_HEADER = 32 + zlib.MAX_WBITS
SHOWN_CHARACTERS = 40


def plain_cloud(payload: memoryview) -> memoryview:
    """Return the message as a PointCloud2. Raises: MessageLayoutError, ByteOrderError, `MSG-330`."""
    cursor, size = _to_data(payload)
    start = cursor.take(cursor.bounded(size.data_bytes, 1))
    is_dense, name = cursor.u8(), cursor.text()
    data = _inflated(payload[start : start + size.data_bytes], name, size.points_bytes)
    return memoryview(bytes(payload[: start - 4]) + struct.pack("<I", len(data)) + data + bytes([is_dense]))


def compressed_problem(head: memoryview, size_bytes: Callable[[], int]) -> str:
    """Return why a message that begins so cannot be decoded; "" if its head does not speak against it.

    `size_bytes` returns the size of the whole message, of which `head` may be all.
    """
    try:
        cursor, size = _to_data(head)
        if len(head) == (whole := size_bytes()):
            plain = plain_cloud(head)
            return layout_problem(plain, lambda: len(plain))
    except IngestError as error:
        return str(error)
    if (end := cursor.at + size.data_bytes) > whole:
        return str(MessageLayoutError(COMPRESSED_CLOUD, f"its data ends at byte {end}, the message has {whole}"))
    return ""


def _to_data(head: memoryview) -> tuple[Cursor, CloudSize]:
    cursor = Cursor(head, COMPRESSED_CLOUD)
    cursor.stamp_ns()
    cursor.text()
    return cursor, cloud_size(cursor)


def _inflated(packed: memoryview, name: str, points_bytes: int) -> bytes:
    """Raises: MessageLayoutError, `MSG-330`."""
    word, most_bytes = name.strip().lower(), min(points_bytes, MOST_CLOUD_BYTES)
    if word not in _CODECS:
        raise IngestError(
            "MSG-330",
            f"{COMPRESSED_CLOUD}: its points are compressed as {name[:SHOWN_CHARACTERS]!r}; zlib and zstd are read: "
            "record the PointCloud2 topic beside it, or play the recording through republish of point_cloud_transport "
            "(out_transport raw) and record that",
        )
    try:
        data = _CODECS[word](packed, most_bytes + 1)
    except (zlib.error, zstandard.ZstdError) as error:
        raise MessageLayoutError(COMPRESSED_CLOUD, f"its {word} data does not inflate ({error})"[:200]) from None
    if len(data) > most_bytes:
        problem = f"its {word} data inflates to more than the {most_bytes} bytes that its points take"
        raise MessageLayoutError(COMPRESSED_CLOUD, problem)
    return data


def _zlib(packed: memoryview, most_bytes: int) -> bytes:
    return zlib.decompressobj(ANY_HEADER).decompress(packed, most_bytes)


def _zstd(packed: memoryview, most_bytes: int) -> bytes:
    with zstandard.ZstdDecompressor(max_window_size=MOST_CLOUD_BYTES).stream_reader(packed) as stream:
        return bytes(stream.read(most_bytes))


_CODECS: Mapping[str, Callable[[memoryview, int], bytes]] = {"zlib": _zlib, "zstd": _zstd}
