"""Select the backend that has an upload's bytes."""

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
# **Conventions.** An upload's row names the backend of its bytes. A backend handles bytes and offsets; `rows.py`
# handles states, quotas and owners. A row changes before its bytes are deleted. After locking the bytes, read the row
# again.


class LockedUpload(Protocol):
    """The bytes of an upload, locked by one request: `append` bytes, `accept` or `discard` them, then `close`."""

    @property
    def kept_bytes(self) -> int:
        """Return the number of bytes that stay if this process is killed now."""
        ...

    def mark_unverified(self) -> None:
        """Do not count bytes appended from now on until `accept`, even if the process is killed before it."""
        ...

    def append(self, pieces: Sequence[bytes], offset_bytes: int) -> None:
        """Add `pieces` at `offset_bytes`, the end of the bytes. Raises `DiskFullError`; bytes that fitted count."""
        ...

    def accept(self, *, is_whole: bool) -> None:
        """Count all appended bytes; a whole upload survives a power cut from now on. Raises `DiskFullError`."""
        ...

    def discard(self) -> None:
        """Drop bytes that were appended and not accepted, unless they are kept permanently already."""
        ...

    def sha256(self) -> str:
        """Return the hash of all bytes in hex, reading them again from the first."""
        ...

    def close(self) -> None:
        """Release the lock. It may be called twice."""
        ...


class UploadBackend(Protocol):
    """Bytes of unfinished uploads; methods raise `FileNotFoundError` if an upload's bytes are gone."""

    def begin(self, upload: Upload) -> bool:
        """Reserve space before the row is created; return True if the owner's own file has supplied all bytes already.

        Raises `DiskFullError`.
        """
        ...

    def enter(self, session: Session, upload: Upload) -> bool:
        """Do as `begin` for a backend whose bytes have rows, after the row and within its transaction."""
        ...

    def offset_of(self, upload_id: str) -> int:
        """Return the number of bytes that count."""
        ...

    def hold(self, upload: Upload) -> LockedUpload:
        """Lock the bytes for one request. Raises `UploadLockedError` while another request has the lock."""
        ...

    def remove(self, upload_id: str) -> None:
        """Delete the bytes, if there are any."""
        ...

    def local(self, upload: Upload) -> AbstractContextManager[Path]:
        """Yield a local file with all bytes of a whole upload, for reading only; a copy is deleted afterwards."""
        ...

    def holding(self) -> Iterator[str]:
        """Yield the uploads that have bytes in this backend, in no order. The listing is lazy and may last minutes."""
        ...

    def is_forgotten(self, upload_id: str) -> bool:
        """Return whether bytes without a row are so old that no row will follow."""
        ...


def backend_of(platform: Platform, upload: Upload) -> UploadBackend:
    """Return the backend that has, or will have, the bytes of `upload`."""
    return StoreUploadBackend(platform) if upload.backend == STORE else FolderUploadBackend(platform)


def backends(platform: Platform) -> tuple[UploadBackend, ...]:
    """Return every backend that may have bytes."""
    return (FolderUploadBackend(platform), StoreUploadBackend(platform))


def remove_bytes(platform: Platform, upload_ids: Iterable[str]) -> None:
    """Delete the bytes of these uploads from all backends."""
    for backend in backends(platform):
        for upload_id in upload_ids:
            backend.remove(upload_id)


# The folder backend of uploads: one file per upload in a folder shared by API and workers.


OURS = re.compile(r"([0-9a-f]{32})(?:\.unverified)?")
ORPHAN_S = 3600.0


class FolderUploadBackend:
    """The backend whose bytes are files of the uploads folder."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform

    def begin(self, upload: Upload) -> bool:
        """Create an empty file, or a hard link to the same bytes if the owner has the declared file already.

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
        """Yield the file itself."""
        path = self._path(upload.id)
        path.stat()
        yield path

    def holding(self) -> Iterator[str]:
        """Yield uploads that have a file, or a mark without a file; an upload with both appears twice."""
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
        """Return whether the owner had the declared bytes already; `path` then links to them."""
        if not upload.declared_sha256:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        for duplicate in duplicates_of(self._platform, upload):
            try:
                os.link(duplicate, path)
            except OSError:  # consumed or collected meanwhile, or on another filesystem: the client sends the bytes
                continue
            sync_folder(path.parent)
            return True
        return False


# The object store backend of uploads: each part is an object with a row (`part_rows.py`).
#
# **Conventions.** Machines share only database and store. A worker that reads an upload copies it into its cache and
# deletes the copy afterwards. The next attempt reuses the copy of a killed worker, or the cache evicts it.


BATCH = 500


class StoreUploadBackend:
    """The backend whose bytes are objects of the store."""

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
        """Delete the rows; garbage collection deletes the objects."""
        if self.offset_of(upload_id):
            part_rows.forget(self._platform, upload_id)

    @contextmanager
    def local(self, upload: Upload) -> Iterator[Path]:
        """Yield a copy in this machine's cache, or the store's own copy of a blob."""
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
        """Yield uploads with parts, in the order of their ids."""
        after = ""
        while True:
            ordered = select(UploadPartRow.upload_id).where(FIRST, UploadPartRow.upload_id > after)
            with self._platform.database.reading() as session:
                upload_ids = session.scalars(ordered.order_by(UploadPartRow.upload_id).limit(BATCH)).all()
            yield from upload_ids
            if len(upload_ids) < BATCH:
                return
            after = upload_ids[-1]

    def is_forgotten(self, upload_id: str) -> bool:
        """Return False: no part exists without a row."""
        return False

    def _cache(self) -> Cache:
        settings = self._platform.settings
        return Cache(settings.root / "cache", settings.store.cache_bytes)

    def _copy(self, parts: list[UploadPart], _key: str, target: Path) -> None:
        copy_parts(self._platform.store, parts, target, self._platform.settings.store.reserve_bytes)
