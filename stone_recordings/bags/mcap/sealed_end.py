"""Where a sealed MCAP file ends when zeros were written behind it, as copying tools and allocated blocks leave them."""

import os
from typing import BinaryIO

from stone_recordings.bags.mcap.records import MAGIC

PIECE_BYTES = 1 << 20


def sealed_bytes(file: BinaryIO) -> int:
    """Bytes up to the closing magic, without the zeros behind it; all of them where something else ends the file.

    Read, not mapped: pages of a map that are looked at count as memory.
    """
    size = stop = file.seek(0, os.SEEK_END)
    while stop > 0:
        start = max(0, stop - PIECE_BYTES)
        rest = len(_read(file, start, stop).rstrip(b"\0"))
        if rest:
            end = start + rest
            return end if _read(file, max(0, end - len(MAGIC)), end) == MAGIC else size
        stop = start
    return size


def _read(file: BinaryIO, start: int, stop: int) -> bytes:
    file.seek(start)
    return file.read(stop - start)
