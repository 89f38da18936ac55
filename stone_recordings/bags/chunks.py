"""Inflate one chunk to exactly the size it declares, or refuse it before the memory is used.

**Conventions.** A chunk may declare at most `CHUNK_LIMIT_BYTES`. A chunk that declares both a large size and a large
growth is first inflated piece by piece without storing, so a bomb costs time, never memory. The CRC-32 is checked if
one was written and the whole chunk is read anyway: compressed chunks when inflated, plain chunks when their first
message is read. A header-only scan does not check it, because that would turn milliseconds into a read of the file. Nor
does a scan that needs only the head of a chunk: a cloud of megabytes is mostly the last message of its chunk.
"""

from bz2 import BZ2Decompressor
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import cramjam
import numpy as np
import zstandard
from isal import isal_zlib
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from stone_recordings.bags.errors import ChecksumError, IngestError, MalformedBagError

CHUNK_LIMIT_BYTES = 512 * 1024 * 1024
# Below this a wrong size costs little memory; above it, growth beyond the ratio is measured before it is allocated.
UNDOUBTED_BYTES = 32 * 1024 * 1024
DOUBTED_RATIO = 20
PIECE_BYTES = 1024 * 1024
# Every call copies the input that LZ4 has not consumed, and most heads end within a few of its blocks.
FED_BYTES = 64 * 1024
MCAP_COMPRESSIONS = ("lz4", "zstd")
_DAMAGED = (RuntimeError, zstandard.ZstdError, EOFError, OSError)  # OSError is bz2's
_CODECS = {"bz2": cramjam.bzip2, "lz4": cramjam.lz4, "zstd": cramjam.zstd}


@dataclass(frozen=True)
class Chunk:
    """A chunk's header; `start:stop` are its (compressed) records in the file.

    `compression` is "" or one of `known`, for which the container has names. If it `is_cut`, the compressed bytes end
    early, and `uncompressed_bytes` is the size that can still be inflated.
    """

    where: str
    uncompressed_bytes: int
    crc32: int
    compression: str
    start: int
    stop: int
    known: tuple[str, ...] = MCAP_COMPRESSIONS
    is_cut: bool = False


def inflate(view: memoryview, chunk: Chunk) -> memoryview:
    """Return the chunk's records, read-only; a slice of `view` if nothing is compressed.

    Raises: `BAG-013`, `BAG-017`, MalformedBagError (another size than declared, or invalid data), ChecksumError.
    """
    packed = view[chunk.start : chunk.stop]
    _check_size(chunk, len(packed))
    if not chunk.compression:
        return packed
    if chunk.is_cut:
        return inflate_head(view, chunk, chunk.uncompressed_bytes)
    if chunk.uncompressed_bytes > max(UNDOUBTED_BYTES, DOUBTED_RATIO * len(packed)):
        _check_true_size(packed, chunk)
    records = _inflated(packed, chunk)
    check_crc32(records, chunk)
    return records


def inflate_head(view: memoryview, chunk: Chunk, stop: int) -> memoryview:
    """Return the first `stop` bytes of a compressed chunk's records, without checking the checksum, which covers all.

    Raises: `BAG-013`, `BAG-017`, MalformedBagError (fewer bytes, or invalid data).
    """
    packed = view[chunk.start : chunk.stop]
    _check_size(chunk, len(packed))
    pieces = _pieces(packed, chunk.compression, stop)
    inflated = bytearray()
    try:
        while len(inflated) < stop and (piece := next(pieces, b"")):
            inflated += piece
    except _DAMAGED as error:
        raise MalformedBagError(chunk.where, _problem(chunk, str(error))) from None
    if len(inflated) < stop:
        raise MalformedBagError(chunk.where, _problem(chunk, f"only {len(inflated)} decompressed"))
    return memoryview(inflated).toreadonly()[:stop]


def pieces_of(packed: memoryview, compression: str, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes | memoryview]:
    """Yield the inflated bytes of a stream that was cut off, piece by piece, up to the last one that inflates."""
    if compression == "":
        yield from (packed[at : at + piece_bytes] for at in range(0, len(packed), piece_bytes))
    elif compression in ("bz2", "lz4", "zstd"):
        with suppress(*_DAMAGED):
            yield from _pieces(packed, compression, piece_bytes)


def check_crc32(records: memoryview, chunk: Chunk) -> None:
    """Check the CRC-32; 0 means that the writer did not compute one (ROS 2 Humble's default)."""
    if chunk.crc32 and (crc32 := isal_zlib.crc32(records)) != chunk.crc32:
        raise ChecksumError(chunk.where, crc32, chunk.crc32)


def _check_size(chunk: Chunk, packed_bytes: int) -> None:
    if chunk.compression not in ("", *chunk.known):
        raise compression_refused(chunk.where, chunk.compression, chunk.known)
    if not chunk.compression and chunk.uncompressed_bytes != packed_bytes:
        problem = f"uncompressed, yet {packed_bytes} bytes are stored for {chunk.uncompressed_bytes} declared"
        raise MalformedBagError(chunk.where, problem)
    if chunk.compression and chunk.uncompressed_bytes > CHUNK_LIMIT_BYTES:
        raise IngestError(
            "BAG-013",
            f"{chunk.where} declares {chunk.uncompressed_bytes} bytes uncompressed, the limit is "
            f"{CHUNK_LIMIT_BYTES}; record with a chunk size of a few MiB",
        )


def _inflated(packed: memoryview, chunk: Chunk) -> memoryview:
    codec = _CODECS[chunk.compression]
    records = np.empty(chunk.uncompressed_bytes, np.uint8)
    try:
        size = codec.decompress_into(packed, records) if len(packed) else 0
    except cramjam.DecompressionError as error:
        raise MalformedBagError(chunk.where, _problem(chunk, str(error))) from None
    if size != chunk.uncompressed_bytes:
        raise MalformedBagError(chunk.where, _problem(chunk, f"only {size} decompressed"))
    return records.data.toreadonly()


def _check_true_size(packed: memoryview, chunk: Chunk) -> None:
    pieces = _pieces(packed, chunk.compression)
    total = 0
    try:
        for piece in pieces:
            total += len(piece)
            if total > chunk.uncompressed_bytes:
                break
    except _DAMAGED as error:
        raise MalformedBagError(chunk.where, _problem(chunk, str(error))) from None
    if total != chunk.uncompressed_bytes:
        raise MalformedBagError(chunk.where, _problem(chunk, f"{total} or more decompressed"))


def _pieces(packed: memoryview, compression: str, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes]:
    if compression == "bz2":
        return _bz2_pieces(packed, piece_bytes)
    return _lz4_pieces(packed, piece_bytes) if compression == "lz4" else _zstd_pieces(packed, piece_bytes)


def _lz4_pieces(packed: memoryview, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes]:
    codec = LZ4FrameDecompressor()
    for at in range(0, len(packed), FED_BYTES):
        piece = codec.decompress(packed[at : at + FED_BYTES], max_length=piece_bytes)
        while piece or not (codec.eof or codec.needs_input):
            yield piece
            piece = b"" if codec.eof else codec.decompress(b"", max_length=piece_bytes)
        if codec.eof:
            return


def _bz2_pieces(packed: memoryview, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes]:
    codec = BZ2Decompressor()
    for at in range(0, len(packed), PIECE_BYTES):
        piece = codec.decompress(packed[at : at + PIECE_BYTES], piece_bytes)
        while piece or not (codec.eof or codec.needs_input):
            yield piece
            piece = b"" if codec.eof else codec.decompress(b"", piece_bytes)
        if codec.eof:
            return


def _zstd_pieces(packed: memoryview, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes]:
    # The window is memory too: nothing larger than the limit of an ordinary level-19 frame is granted.
    codec = zstandard.ZstdDecompressor(max_window_size=UNDOUBTED_BYTES)
    with codec.stream_reader(packed, read_across_frames=True) as stream:
        while piece := stream.read(piece_bytes):
            yield piece


def _problem(chunk: Chunk, fault: str) -> str:
    return f"{chunk.compression} data does not decompress to the declared {chunk.uncompressed_bytes} bytes ({fault})"


def compression_refused(where: str, compression: str, known: tuple[str, ...]) -> IngestError:
    read = ", ".join(repr(name) for name in known)
    return IngestError("BAG-017", f"{where} is compressed with {compression!r}; {read} and none are read")
