"""Where a sealed MCAP file ends when zeros were written behind it, as copying tools and allocated blocks leave them."""

import os
from typing import BinaryIO

from stone_recordings.bags.mcap.records import MAGIC

PIECE_BYTES = 1 << 20
# Nobody allocates more ahead; to look through more takes longer than it is worth.
MOST_ZEROS_BYTES = 16 << 30


def sealed_bytes(file: BinaryIO) -> int | None:
    """Bytes up to the closing magic, without the zeros behind it; None where something else ends the file.

    Read, not mapped: pages of a map that are looked at count as memory.
    """
    size = stop = file.seek(0, os.SEEK_END)
    while stop > 0 and size - stop < MOST_ZEROS_BYTES:
        start = max(0, stop - PIECE_BYTES)
        rest = len(_read(file, start, stop).rstrip(b"\0"))
        if rest:
            end = start + rest
            return end if _read(file, max(0, end - len(MAGIC)), end) == MAGIC else None
        stop = start
    return None


def _read(file: BinaryIO, start: int, stop: int) -> bytes:
    file.seek(start)
    return file.read(stop - start)
