"""Write the bytes of one request to the store, part by part.

**Conventions.** Received bytes are spooled. A thread stores each part when it is full, or old because the connection is
slow, while the next part arrives. Stored parts are added to the upload in order, so counted bytes are always a prefix
of the file. A kill −9 costs the parts not added yet, at most `UNDER_WAY` + 1. Requests of one process lock each other
out, as in a folder. Requests of several processes do not: the first to add its part continues, the other receives its
resume offset (`part_rows.py`) and loses at most one part.
"""

import hashlib
import os
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex

import structlog
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.store.folder import refusing_full
from services.runtime.store.free_space import require_room
from services.runtime.store.garbage_collection import UPLOADS
from services.runtime.store.keys import ObjectMissingError, StoreFullError
from services.runtime.store.protocol import Store
from services.runtime.uploads import part_rows
from services.runtime.uploads.errors import DiskFullError, UploadLockedError
from services.runtime.uploads.part_rows import UploadPart
from services.runtime.uploads.spool import Spool, split
from stone.errors import Refused, StoneError

UNDER_WAY = 1
OLD_S = 10.0
MOST_PARTS = 200_000
STORING = ThreadPoolExecutor(8, thread_name_prefix="part")

log = structlog.get_logger(__name__)


class _UploadLocks:
    """The uploads that requests of this process have locked."""

    def __init__(self) -> None:
        self._ids: set[str] = set()
        self._guard = threading.Lock()

    def take(self, upload_id: str) -> None:
        """Lock an upload. Raises `UploadLockedError`."""
        with self._guard:
            if upload_id in self._ids:
                raise UploadLockedError(upload_id)
            self._ids.add(upload_id)

    def give_back(self, upload_id: str) -> None:
        with self._guard:
            self._ids.discard(upload_id)


UPLOAD_LOCKS = _UploadLocks()


class LockedUploadParts:
    """An upload in the store, locked by one request (a `LockedUpload`). Raises `UploadLockedError`."""

    def __init__(self, platform: Platform, upload: Upload) -> None:
        UPLOAD_LOCKS.take(upload.id)
        self._is_held = True
        try:
            with platform.database.reading() as session:
                self._kept_bytes = self._reached = part_rows.end_of(session, upload.id)
                self._count = part_rows.count_of(session, upload.id)
        except BaseException:
            UPLOAD_LOCKS.give_back(upload.id)
            raise
        self._platform, self._upload = platform, upload
        self._spool: Spool | None = None
        self._begun_s = 0.0
        self._under_way: deque[tuple[UploadPart, Future[None]]] = deque()
        self._stored: list[UploadPart] = []
        self._is_unverified = False

    @property
    def kept_bytes(self) -> int:
        return self._kept_bytes

    def mark_unverified(self) -> None:
        """Store parts as they arrive, but add them all at once in `accept`."""
        self._is_unverified = True

    def append(self, pieces: Sequence[bytes], offset_bytes: int) -> None:
        """Append bytes; added parts count.

        Raises `DiskFullError`, `too_many_small_requests`, and the errors of adding.
        """
        with self._giving_up_on_error():
            if self._count >= MOST_PARTS:
                raise Refused(
                    "too_many_small_requests",
                    f"upload {self._upload.id} has {MOST_PARTS} parts, which is the limit; "
                    "create a new upload and send it in larger requests, of a few MiB each",
                )
            try:
                self._take(pieces)
            except DiskFullError:  # this machine's disk is full: store the bytes that fitted
                self._store_all()
                raise
            self._add_stored(UNDER_WAY)

    def accept(self, *, is_whole: bool) -> None:
        """Store and add all bytes. Raises as `append`."""
        with self._giving_up_on_error():
            self._is_unverified = False
            self._store_all()

    def discard(self) -> None:
        """Drop bytes that were not added yet; added bytes stay."""
        self._give_up()

    def sha256(self) -> str:
        """Return the hash of the bytes, read back from the store."""
        with self._platform.database.reading() as session:
            parts = part_rows.upload_parts_of(session, self._upload.id)
        return sha256_of_parts(self._platform.store, parts)

    def close(self) -> None:
        """Add the bytes of an interrupted request, unless a checksum was declared for them."""
        if not self._is_held:
            return
        self._is_held = False
        try:
            self._store_rest()
        finally:
            UPLOAD_LOCKS.give_back(self._upload.id)

    def _store_rest(self) -> None:
        if self._is_unverified:
            self._give_up()
        try:
            self.accept(is_whole=False)
        except (StoneError, SQLAlchemyError, OSError) as error:
            log.warning("bytes not kept", upload_id=self._upload.id, reason=f"{type(error).__name__}: {error}"[:500])

    def _take(self, pieces: Sequence[bytes]) -> None:
        rest = [memoryview(piece) for piece in pieces if piece]
        part_bytes = self._platform.settings.uploads.part_bytes
        while rest:
            spool = self._opened()
            fitting, rest = split(rest, part_bytes - spool.size_bytes)
            spool.write(fitting)
            if spool.size_bytes >= part_bytes or time.monotonic() - self._begun_s > OLD_S:
                self._hand_over()

    def _opened(self) -> Spool:
        if self._spool is None:
            settings = self._platform.settings
            self._spool = Spool(settings.uploads_folder, settings.store.reserve_bytes)
            self._begun_s = time.monotonic()
        return self._spool

    def _hand_over(self) -> None:
        """Start a thread that stores the spooled bytes."""
        spool, self._spool = self._spool, None
        if spool is None:
            return
        key = f"{UPLOADS}{self._upload.id}/{self._reached:012x}-{token_hex(8)}"
        part = UploadPart(key, self._reached, spool.size_bytes)
        rest_bytes = self._upload.length_bytes - self._reached
        try:
            part_rows.announce(self._platform, key, rest_bytes if self._is_unverified else part.length_bytes)
            self._under_way.append((part, STORING.submit(self._store, key, spool)))
        except BaseException:
            spool.close()
            raise
        self._reached = part.end_bytes

    def _store(self, key: str, spool: Spool) -> None:
        try:
            self._platform.store.write(key, spool.path)
        finally:
            spool.close()

    def _store_all(self) -> None:
        self._hand_over()
        self._add_stored(0)

    def _add_stored(self, most_under_way: int) -> None:
        """Add stored parts; wait until at most `most_under_way` parts are not stored."""
        while len(self._under_way) > most_under_way or (self._under_way and self._under_way[0][1].done()):
            self._under_way[0][1].result()
            self._stored.append(self._under_way.popleft()[0])
        if self._stored and not self._is_unverified:
            part_rows.add(self._platform, self._upload.id, self._stored)
            self._count += len(self._stored)
            self._kept_bytes = self._stored[-1].end_bytes
            self._stored = []

    @contextmanager
    def _giving_up_on_error(self) -> Iterator[None]:
        """Release all parts not added yet if the block raises."""
        try:
            yield
        except (DiskFullError, StoreFullError) as error:
            self._give_up()
            why = error.why if isinstance(error, DiskFullError) else str(error)
            raise DiskFullError(self._kept_bytes, why) from error
        except BaseException:
            self._give_up()
            raise

    def _give_up(self) -> None:
        if self._spool is not None:
            self._spool.close()
        wait([storing for _, storing in self._under_way])
        keys = [part.key for part in (*self._stored, *(part for part, _ in self._under_way))]
        self._spool, self._stored, self._reached = None, [], self._kept_bytes
        self._under_way.clear()
        try:
            part_rows.give_up(self._platform, keys)
        except SQLAlchemyError as error:  # garbage collection finds them later
            log.warning("objects left behind", keys=len(keys), reason=type(error).__name__)


# Read upload parts from the store: to hash the whole, or to copy it into one local file.


AHEAD = 3
"""The number of parts read ahead, all in memory."""


def sha256_of_parts(store: Store, parts: Sequence[UploadPart]) -> str:
    """Return the digest of their bytes in this order. Raises `ObjectMissingError`, `store_unavailable`."""
    state = hashlib.sha256()
    for content in _contents(store, parts):
        state.update(content)
    return state.hexdigest()


def copy_parts(store: Store, parts: Sequence[UploadPart], target: Path, reserve_bytes: int) -> None:
    """Write the parts into the file `target` and flush it.

    Raises `ObjectMissingError`, `store_unavailable`, `StoreFullError`.
    """
    require_room(target.parent, sum(part.length_bytes for part in parts), reserve_bytes)
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
