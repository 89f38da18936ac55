"""Slabs read back from the store: for the sha256 of the whole, or as one file on this machine."""

import hashlib
import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from services.runtime.store import Store
from services.runtime.store_folder import refusing_full
from services.runtime.store_keys import ObjectMissingError
from services.runtime.uploads.slab_rows import Slab

AHEAD = 3
"""Slabs that are read while one is worked on; all of them are in memory."""


def sha256_of_slabs(store: Store, slabs: Sequence[Slab]) -> str:
    """Of their bytes one after the other. Raises `ObjectMissingError`, `StoreAwayError`."""
    state = hashlib.sha256()
    for content in _contents(store, slabs):
        state.update(content)
    return state.hexdigest()


def copy_slabs(store: Store, slabs: Sequence[Slab], target: Path) -> None:
    """Write them into the file `target`, flushed. Raises `ObjectMissingError`, `StoreAwayError`, `StoreFullError`."""
    with refusing_full(target.parent), target.open("wb") as file, ThreadPoolExecutor(AHEAD) as pool:
        list(pool.map(lambda slab: _copy(store, slab, file.fileno()), slabs))
        os.fsync(file.fileno())


def _contents(store: Store, slabs: Sequence[Slab]) -> Iterator[bytes]:
    coming: deque[Future[bytes]] = deque()
    with ThreadPoolExecutor(AHEAD) as pool:
        for slab in slabs:
            coming.append(pool.submit(_content, store, slab))
            if len(coming) > AHEAD:
                yield coming.popleft().result()
        while coming:
            yield coming.popleft().result()


def _content(store: Store, slab: Slab) -> bytes:
    content = b"".join(store.read(slab.key, 0, slab.length_bytes))
    if len(content) != slab.length_bytes:
        raise ObjectMissingError(slab.key)
    return content


def _copy(store: Store, slab: Slab, descriptor: int) -> None:
    offset_bytes = slab.offset_bytes
    for piece in store.read(slab.key, 0, slab.length_bytes):
        offset_bytes += os.pwrite(descriptor, piece, offset_bytes)
    if offset_bytes != slab.end_bytes:
        raise ObjectMissingError(slab.key)
