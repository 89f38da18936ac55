"""Selects the backend that has an upload's bytes."""

import os
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Protocol

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Upload, UploadPartRow
from services.runtime.orm.sequences import FIRST
from services.runtime.platform import Platform
from services.runtime.store.cache import Cache
from services.runtime.store.garbage_collection import UPLOADS
from services.runtime.uploads import part_rows
from services.runtime.uploads.files import LockedUploadFile, make_file, offset_of, remove_file, sync_folder, upload_file
from services.runtime.uploads.part_rows import STORE, UploadPart
from services.runtime.uploads.part_writer import LockedUploadParts, copy_parts
from services.runtime.uploads.rows import duplicates_of

# The upload backend interface, implemented by a shared folder and by the object store.
#
# **Conventions.** An upload's row says in which backend its bytes are. A backend knows bytes and offsets; states,
# quotas and owners are the rows' (`rows.py`), and a row changes before its bytes go. Whoever holds bytes reads the row
# again.


class LockedUpload(Protocol):
    """The bytes of an upload, held by one request: `append` what comes, `accept` or `discard` it, then `close`."""

    @property
    def kept_bytes(self) -> int:
        """The number of bytes that stay when this process is killed now."""
        ...

    def mark_unverified(self) -> None:
        """Let what is appended from now on not count until `accept`, even when the process is killed before."""
        ...

    def append(self, pieces: Sequence[bytes], offset_bytes: int) -> None:
        """Add `pieces` at `offset_bytes`, the end of what was appended. Raises `DiskFullError`; what fitted counts."""
        ...

    def accept(self, *, is_whole: bool) -> None:
        """All that was appended counts; a whole upload survives a power cut from now on. Raises `DiskFullError`."""
        ...

    def discard(self) -> None:
        """Drop what was appended and not accepted, as far as it is not kept for ever already."""
        ...

    def sha256(self) -> str:
        """The hash of all bytes, read again from the first one; in hex."""
        ...

    def close(self) -> None:
        """Let go. May be called twice."""
        ...


class UploadBackend(Protocol):
    """Bytes under way by upload; `FileNotFoundError` where those of an upload are gone."""

    def begin(self, upload: Upload) -> bool:
        """Make room before the row comes to be; true when the owner's own file has given it all its bytes already.

        Raises `DiskFullError`.
        """
        ...

    def enter(self, session: Session, upload: Upload) -> bool:
        """Within the transaction that makes the row, after it: as `begin`, for a backend whose bytes have rows."""
        ...

    def offset_of(self, upload_id: str) -> int:
        """The number of bytes that count."""
        ...

    def hold(self, upload: Upload) -> LockedUpload:
        """Raises `UploadLockedError` while another request holds them."""
        ...

    def remove(self, upload_id: str) -> None:
        """The bytes go; nothing happens where there are none."""
        ...

    def local(self, upload: Upload) -> AbstractContextManager[Path]:
        """A file on this machine with all bytes of a whole upload, to be read only; a copy goes with the block."""
        ...

    def holding(self) -> Iterator[str]:
        """The uploads that have bytes here, in no order, found as they are asked for: over minutes, if need be."""
        ...

    def is_forgotten(self, upload_id: str) -> bool:
        """Whether bytes without a row are so old that no row is about to come."""
        ...


def backend_of(platform: Platform, upload: Upload) -> UploadBackend:
    """Where the bytes of `upload` are, or are to come."""
    return StoreUploadBackend(platform) if upload.backend == STORE else FolderUploadBackend(platform)


def backends(platform: Platform) -> tuple[UploadBackend, ...]:
    """Every backend that bytes may be in."""
    return (FolderUploadBackend(platform), StoreUploadBackend(platform))


def remove_bytes(platform: Platform, upload_ids: Iterable[str]) -> None:
    """The bytes of these uploads go, wherever they are."""
    for backend in backends(platform):
        for upload_id in upload_ids:
            backend.remove(upload_id)


# The folder backend of uploads: one file per upload in a folder shared by API and workers.


OURS = re.compile(r"([0-9a-f]{32})(?:\.unverified)?")
ORPHAN_S = 3600.0


class FolderUploadBackend:
    """`Place` of the uploads folder."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform

    def begin(self, upload: Upload) -> bool:
        """An empty file; or a second name for the same bytes on disk, where the owner has the declared file already.

        Raises `DiskFullError`.
        """
        path = self._path(upload.id)
        if self._link_duplicate(upload, path):
            return True
        make_file(path)
        return False

    def enter(self, session: Session, upload: Upload) -> bool:
        return False

    def offset_of(self, upload_id: str) -> int:
        return offset_of(self._path(upload_id))

    def hold(self, upload: Upload) -> LockedUploadFile:
        return LockedUploadFile(self._path(upload.id), self._platform.settings.store.reserve_bytes)

    def remove(self, upload_id: str) -> None:
        remove_file(self._path(upload_id))

    @contextmanager
    def local(self, upload: Upload) -> Iterator[Path]:
        """The file itself."""
        path = self._path(upload.id)
        path.stat()
        yield path

    def holding(self) -> Iterator[str]:
        """Uploads that have a file, or a mark whose file is gone; twice those that have both."""
        folder = self._platform.settings.uploads_folder
        if not folder.is_dir():
            return
        with os.scandir(folder) as entries:
            for entry in entries:
                if match := OURS.fullmatch(entry.name):
                    yield match[1]

    def is_forgotten(self, upload_id: str) -> bool:
        with suppress(FileNotFoundError):
            return time.time() - self._path(upload_id).stat().st_mtime > ORPHAN_S
        return True

    def _path(self, upload_id: str) -> Path:
        return upload_file(self._platform.settings, upload_id)

    def _link_duplicate(self, upload: Upload, path: Path) -> bool:
        """Whether the owner had the declared bytes already, and `path` names them now."""
        if not upload.declared_sha256:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        for duplicate in duplicates_of(self._platform, upload):
            try:
                os.link(duplicate, path)
            except OSError:  # consumed or collected meanwhile, or on another filesystem: then it is sent again
                continue
            sync_folder(path.parent)
            return True
        return False


# The object store backend of uploads: each part is an object with a row (`part_rows.py`).
#
# **Conventions.** Nothing is shared between machines but database and store. A worker that reads an upload copies it
# into its cache and removes the copy; what a killed one leaves is found by the next attempt, or evicted.


BATCH = 500


class StoreUploadBackend:
    """`Place` of the store."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform

    def begin(self, upload: Upload) -> bool:
        return False

    def enter(self, session: Session, upload: Upload) -> bool:
        """Share the objects of the owner's own file."""
        return part_rows.share(session, upload)

    def offset_of(self, upload_id: str) -> int:
        with self._platform.database.reading() as session:
            return part_rows.end_of(session, upload_id)

    def hold(self, upload: Upload) -> LockedUploadParts:
        return LockedUploadParts(self._platform, upload)

    def remove(self, upload_id: str) -> None:
        """The rows go; garbage collection deletes the objects."""
        if self.offset_of(upload_id):
            part_rows.forget(self._platform, upload_id)

    @contextmanager
    def local(self, upload: Upload) -> Iterator[Path]:
        """A copy in this machine's cache; of what is a blob the store's own."""
        with self._platform.database.reading() as session:
            parts = part_rows.upload_parts_of(session, upload.id)
        if sum(part.length_bytes for part in parts) != upload.length_bytes:
            raise FileNotFoundError(upload.id)
        if len(parts) == 1 and parts[0].blob_sha256 is not None:
            yield self._platform.store.local(parts[0].key)
            return
        with self._cache().borrowed(f"{UPLOADS}{upload.id}", partial(self._copy, parts)) as path:
            yield path

    def holding(self) -> Iterator[str]:
        """Uploads with parts, in the order of their ids."""
        after = ""
        while True:
            ordered = select(UploadPartRow.upload_id).where(FIRST, UploadPartRow.upload_id > after)
            with self._platform.database.reading() as session:
                found = session.scalars(ordered.order_by(UploadPartRow.upload_id).limit(BATCH)).all()
            yield from found
            if len(found) < BATCH:
                return
            after = found[-1]

    def is_forgotten(self, upload_id: str) -> bool:
        """There are no parts without a row."""
        return False

    def _cache(self) -> Cache:
        settings = self._platform.settings
        return Cache(settings.root / "cache", settings.store.cache_bytes)

    def _copy(self, parts: list[UploadPart], _key: str, target: Path) -> None:
        copy_parts(self._platform.store, parts, target, self._platform.settings.store.reserve_bytes)
