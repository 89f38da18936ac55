"""Bytes under way in the store: each run of them an object, each object a row (`slab_rows.py`).

**Conventions.** Nothing is shared between machines but database and store. A worker that reads an upload copies it into
its cache and removes the copy; what a killed one leaves is found by the next attempt, or evicted.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.collection import UPLOADS
from services.runtime.orm import Upload, UploadSlab
from services.runtime.orm.slabs import FIRST
from services.runtime.platform import Platform
from services.runtime.store_cache import Cache
from services.runtime.uploads import slab_rows
from services.runtime.uploads.held_slabs import HeldSlabs
from services.runtime.uploads.slab_reading import copy_slabs
from services.runtime.uploads.slab_rows import Slab

NEEDED = ("open", "complete")


class StorePlace:
    """`Place` of the store."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform

    def begin(self, upload: Upload) -> bool:
        return False

    def enter(self, session: Session, upload: Upload) -> bool:
        """Share the objects of the owner's own file."""
        return slab_rows.share(session, upload)

    def offset_of(self, upload_id: str) -> int:
        with self._platform.database.reading() as session:
            return slab_rows.end_of(session, upload_id)

    def hold(self, upload: Upload) -> HeldSlabs:
        return HeldSlabs(self._platform, upload)

    def remove(self, upload_id: str) -> None:
        """The rows go; the collection deletes the objects."""
        if self.offset_of(upload_id):
            slab_rows.forget(self._platform, upload_id)

    @contextmanager
    def local(self, upload: Upload) -> Iterator[Path]:
        """A copy in this machine's cache; of what is a blob the store's own."""
        with self._platform.database.reading() as session:
            slabs = slab_rows.slabs_of(session, upload.id)
        if sum(slab.length_bytes for slab in slabs) != upload.length_bytes:
            raise FileNotFoundError(upload.id)
        if len(slabs) == 1 and slabs[0].blob_sha256 is not None:
            yield self._platform.store.local(slabs[0].key)
            return
        with self._cache().borrowed(f"{UPLOADS}{upload.id}", partial(self._copy, slabs)) as path:
            yield path

    def holding(self) -> Iterable[str]:
        """Of uploads that have ended, or are used."""
        ended = select(UploadSlab.upload_id).join(Upload, Upload.id == UploadSlab.upload_id)
        with self._platform.database.reading() as session:
            return session.scalars(ended.where(FIRST, Upload.state.not_in(NEEDED))).all()

    def is_forgotten(self, upload_id: str) -> bool:
        """There are no slabs without a row."""
        return False

    def _cache(self) -> Cache:
        settings = self._platform.settings
        return Cache(settings.root / "cache", settings.store.cache_bytes)

    def _copy(self, slabs: list[Slab], _key: str, target: Path) -> None:
        copy_slabs(self._platform.store, slabs, target)
