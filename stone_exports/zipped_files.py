"""Files of a zip, read in place by ranges and inflated in pieces, up to the size in the directory.

**Conventions.** `size_bytes` is the inflated size, `offset_bytes` the offset of the local header. Size and checksum are
checked whenever a file is read to its end. A small member and its header are fetched in one range.

Source: RFC 1951; `stone_files/zip_directory.py`.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from isal import isal_zlib

from stone_exports.files import PIECE_BYTES, ExportFileSpan
from stone_files.archives import DEFLATED
from stone_files.byte_ranges import ByteRanges
from stone_files.zip_directory import ReadAt, ZipFaultError, ZipMember, payload_span

AT_ONCE_BYTES = 8 * 2**20
RAW = -15
INFLATING: type[Exception] = isal_zlib.error  # type: ignore[assignment]


@dataclass(frozen=True)
class ZippedFileSpan(ExportFileSpan):
    """One member of the zip in `ranges`, as a file of an export."""

    member: ZipMember
    ranges: ByteRanges

    def pieces(self) -> Iterator[bytes]:
        """Yield the bytes in pieces. Raises `DamagedExportError` if they contradict the directory."""
        read_bytes, checksum = 0, 0
        for piece in self._inflated():
            read_bytes += len(piece)
            if read_bytes > self.size_bytes:
                raise self.damaged(f"it continues after its declared {self.size_bytes} bytes")
            checksum = isal_zlib.crc32(piece, checksum)
            yield piece
        if read_bytes < self.size_bytes:
            raise self.damaged(f"it ends {self.size_bytes - read_bytes} bytes early")
        if checksum != self.member.crc32:
            raise self.damaged("its checksum differs from the zip's directory")

    def part(self, start: int, most_bytes: int) -> bytes:
        """Return at most `most_bytes` bytes from `start`, fewer at the end. Raises `DamagedExportError`."""
        stop = min(start + most_bytes, self.size_bytes)
        if self.member.method != DEFLATED:
            first, last = self._place(self.ranges.read_at)
            return self.ranges.read_at(first + start, max(min(stop, last - first) - start, 0))
        part, offset = bytearray(), 0
        for piece in self._inflated():
            part += piece[max(start - offset, 0) : max(stop - offset, 0)]
            offset += len(piece)
            if offset >= stop:
                break
        return bytes(part)

    def identity(self) -> list[str | int]:
        return [self.name, self.offset_bytes, self.size_bytes, self.member.crc32, *self.ranges.identity()]

    def _inflated(self) -> Iterator[bytes]:
        read_at = self._fetched()
        start, stop = self._place(read_at)
        inflating = isal_zlib.decompressobj(RAW) if self.member.method == DEFLATED else None
        for offset in range(start, stop, PIECE_BYTES):
            packed = read_at(offset, min(PIECE_BYTES, stop - offset))
            if len(packed) < min(PIECE_BYTES, stop - offset):
                raise self.damaged("the zip was truncated while it was read")
            if inflating is None:
                yield packed
                continue
            piece = packed
            while not inflating.eof and (packed or piece):  # output may remain after the last input
                try:
                    piece = inflating.decompress(packed, PIECE_BYTES)
                except INFLATING as error:
                    raise self.damaged("it cannot be decompressed") from error
                packed = inflating.unconsumed_tail
                yield piece

    def _place(self, read_at: ReadAt) -> tuple[int, int]:
        try:
            return payload_span(read_at, self.member)
        except ZipFaultError as fault:
            raise self.damaged(str(fault)) from fault

    def _fetched(self) -> ReadAt:
        """Return a function that reads the member; for a small member, it uses one range."""
        first, read_at = self.member.offset, self.ranges.read_at
        if self.member.limit - first > AT_ONCE_BYTES:
            return read_at
        held = read_at(first, self.member.limit - first)
        return lambda offset, count: held[offset - first :][:count]
