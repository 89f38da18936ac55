"""Rolling sha256 of uploads, so that a complete file need not be read again.

**Conventions.** A state is kept only between two requests of one process that continue each other; it is taken out to
be used, so nobody else can add to it. Whoever finds none hashes the file instead. A state is true for the bytes below
its offset for ever: what a request cuts off again lies above the offset at which it began.
"""

import hashlib
import os
import threading

from cachetools import LRUCache

PIECE_BYTES = 1 << 20


class RollingHashes:
    """The states of the uploads this process received last, at most `capacity` of them."""

    def __init__(self, capacity: int = 1024) -> None:
        self._states: LRUCache[str, tuple[int, hashlib._Hash | None]] = LRUCache(capacity)
        self._guard = threading.Lock()

    def take(self, upload_id: str, offset_bytes: int) -> "hashlib._Hash | None":
        """The state over the bytes [0, offset), a fresh one at 0; None when this process has not seen them all."""
        with self._guard:
            seen_bytes, state = self._states.pop(upload_id, (0, None))
        if offset_bytes == 0:
            return hashlib.sha256()
        return state if seen_bytes == offset_bytes else None

    def keep(self, upload_id: str, offset_bytes: int, state: "hashlib._Hash") -> None:
        """Remember the state over the bytes [0, offset)."""
        with self._guard:
            self._states[upload_id] = (offset_bytes, state)


ROLLING = RollingHashes()


def sha256_of(descriptor: int) -> str:
    """The sha256 of an open file from its first byte, in hex."""
    state = hashlib.sha256()
    piece = bytearray(PIECE_BYTES)
    offset = 0
    while count := os.preadv(descriptor, [piece], offset):
        state.update(memoryview(piece)[:count])
        offset += count
    return state.hexdigest()
