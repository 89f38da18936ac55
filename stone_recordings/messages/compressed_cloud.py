"""The PointCloud2 inside a CompressedPointCloud2 of point_cloud_transport.

**Conventions.** The two messages are alike up to the points, so the checks of a PointCloud2 hold for both. The formats
"zlib" (a stream with a zlib or gzip header) and "zstd" are lossless; the others are refused by name. At most the
declared size of the cloud is inflated. Source: point_cloud_interfaces, point_cloud_transport_plugins.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping

import zstandard

from stone_recordings.bags.errors import IngestError, MessageLayoutError
from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD
from stone_recordings.messages.pointcloud2 import CloudSize, cloud_size, layout_problem
from stone_recordings.messages.types.cdr import Cursor

# A revolution of a million points of 32 bytes; one of an OT128 with two returns has 0.9.
MOST_CLOUD_BYTES, PIECE_BYTES, MOST_WINDOW_BYTES = 32 << 20, 1 << 20, 8 << 20
ANY_HEADER = 32 + zlib.MAX_WBITS
SHOWN_CHARACTERS = 40


def plain_cloud(payload: memoryview) -> memoryview:
    """Return the message as a PointCloud2. Raises: MessageLayoutError, ByteOrderError, CloudLayoutError, `MSG-330`."""
    cursor, size = _to_data(payload)
    start = cursor.take(cursor.bounded(size.data_bytes, 1))
    is_dense, name = cursor.u8(), cursor.text()
    points_bytes = min(max(size.points_bytes, size.rows_bytes), MOST_CLOUD_BYTES)
    plain = bytearray(start + points_bytes + 1)
    plain[: start - 4] = payload[: start - 4]
    packed, room = payload[start : start + size.data_bytes], memoryview(plain)[start : start + points_bytes]
    inflated_bytes = _inflated(packed, name, room)
    if inflated_bytes not in (size.points_bytes, size.rows_bytes):  # the stream was cut
        problem = f"its data inflates to {inflated_bytes} bytes, its points take {size.points_bytes}"
        raise MessageLayoutError(COMPRESSED_CLOUD, problem)
    plain[start - 4 : start] = inflated_bytes.to_bytes(4, "little")
    plain[start + inflated_bytes] = is_dense
    return memoryview(plain).toreadonly()[: start + inflated_bytes + 1]


def compressed_problem(head: memoryview, size_bytes: Callable[[], int]) -> str:
    """Return why a message with this head cannot be decoded; "" if the head is valid.

    `size_bytes` returns the size of the whole message; `head` may be all of it.
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


def _inflated(packed: memoryview, name: str, room: memoryview) -> int:
    """Fill the room from its start; return the number of bytes. Raises: MessageLayoutError, `MSG-330`."""
    word = name.strip().lower()
    if word not in _CODECS:
        raise IngestError(
            "MSG-330",
            f"{COMPRESSED_CLOUD}: its points are compressed as {name[:SHOWN_CHARACTERS]!r}; zlib and zstd are "
            "supported. Record the PointCloud2 topic beside it, or play the recording through republish of "
            "point_cloud_transport "
            "(out_transport raw) and record that",
        )
    at = 0
    try:
        for piece in _CODECS[word](packed):
            if at + len(piece) > len(room):
                problem = f"its {word} data inflates to more than the {len(room)} bytes that its points take"
                raise MessageLayoutError(COMPRESSED_CLOUD, problem)
            room[at : at + len(piece)] = piece
            at += len(piece)
    except (zlib.error, zstandard.ZstdError) as error:
        raise MessageLayoutError(COMPRESSED_CLOUD, f"its {word} data does not inflate ({error})"[:200]) from None
    return at


def _zlib(packed: memoryview) -> Iterator[bytes]:
    stream, rest = zlib.decompressobj(ANY_HEADER), bytes(packed)
    while piece := stream.decompress(rest, PIECE_BYTES):
        yield piece
        rest = stream.unconsumed_tail


def _zstd(packed: memoryview) -> Iterator[bytes]:
    with zstandard.ZstdDecompressor(max_window_size=MOST_WINDOW_BYTES).stream_reader(packed) as stream:
        while piece := stream.read(PIECE_BYTES):
            yield piece


_CODECS: Mapping[str, Callable[[memoryview], Iterator[bytes]]] = {"zlib": _zlib, "zstd": _zstd}
