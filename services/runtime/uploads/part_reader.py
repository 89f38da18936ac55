"""Reads upload parts from the store: to hash the whole, or to copy it into one local file."""

import hashlib
import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from services.runtime.store.folder import refusing_full
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.protocol import Store
from services.runtime.uploads.part_rows import UploadPart

AHEAD = 3
"""Parts that are read while one is worked on; all of them are in memory."""


def sha256_of_parts(store: Store, parts: Sequence[UploadPart]) -> str:
    """Of their bytes one after the other. Raises `ObjectMissingError`, `StoreAwayError`."""
    state = hashlib.sha256()
    for content in _contents(store, parts):
        state.update(content)
    return state.hexdigest()


def copy_parts(store: Store, parts: Sequence[UploadPart], target: Path) -> None:
    """Write them into the file `target`, flushed. Raises `ObjectMissingError`, `StoreAwayError`, `StoreFullError`."""
    with refusing_full(target.parent), target.open("wb") as file, ThreadPoolExecutor(AHEAD) as pool:
        list(pool.map(lambda part: _copy(store, part, file.fileno()), parts))
        os.fsync(file.fileno())


def _contents(store: Store, parts: Sequence[UploadPart]) -> Iterator[bytes]:
    coming: deque[Future[bytes]] = deque()
    with ThreadPoolExecutor(AHEAD) as pool:
        for part in parts:
            coming.append(pool.submit(_content, store, part))
            if len(coming) > AHEAD:
                yield coming.popleft().result()
        while coming:
            yield coming.popleft().result()


def _content(store: Store, part: UploadPart) -> bytes:
    content = b"".join(store.read(part.key, 0, part.length_bytes))
    if len(content) != part.length_bytes:
        raise ObjectMissingError(part.key)
    return content


def _copy(store: Store, part: UploadPart, descriptor: int) -> None:
    offset_bytes = part.offset_bytes
    for piece in store.read(part.key, 0, part.length_bytes):
        offset_bytes += os.pwrite(descriptor, piece, offset_bytes)
    if offset_bytes != part.end_bytes:
        raise ObjectMissingError(part.key)
