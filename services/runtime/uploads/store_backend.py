"""The object store backend of uploads: each part is an object with a row (`part_rows.py`).

**Conventions.** Nothing is shared between machines but database and store. A worker that reads an upload copies it into
its cache and removes the copy; what a killed one leaves is found by the next attempt, or evicted.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Upload, UploadPartRow
from services.runtime.orm.upload_parts import FIRST
from services.runtime.platform import Platform
from services.runtime.store.cache import Cache
from services.runtime.store.garbage_collection import UPLOADS
from services.runtime.uploads import part_rows
from services.runtime.uploads.part_reader import copy_parts
from services.runtime.uploads.part_rows import UploadPart
from services.runtime.uploads.part_writer import LockedUploadParts

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
        copy_parts(self._platform.store, parts, target)
