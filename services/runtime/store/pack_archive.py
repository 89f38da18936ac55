"""The files of a finished export, and the archives made of them.

**Conventions.** Indexes and layouts are held by a process, the last few: an object never changes, so neither does what
was read of it.
"""

from dataclasses import dataclass
from functools import lru_cache

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Blob, Export, ExportPack
from services.runtime.store.pack_reading import StoredFiles
from services.runtime.store.packs import PackedFiles, read_index
from services.runtime.store.protocol import Store
from stone.errors import StoneError
from stone_files.virtual_archive import Archive, Kind, layout

HELD = 4


class ExportUnfinishedError(StoneError):
    """The files of an export are there once its job has succeeded."""

    code = "export_unfinished"

    def __init__(self, export_id: str, job_id: str) -> None:
        super().__init__(
            f"export {export_id} has no files yet; job {job_id} makes them, ask again when it has succeeded"
        )


@dataclass(frozen=True)
class ExportLocation:
    """The objects of the store that hold an export."""

    index_key: str
    pack_keys: tuple[str, ...]


def locate_export(session: Session, export: Export) -> ExportLocation:
    """The places of an export's files. Raises `ExportUnfinishedError`."""
    if export.index_sha256 is None:
        raise ExportUnfinishedError(export.id, export.job_id)
    packs = select(Blob.object_key).join(ExportPack, ExportPack.blob_sha256 == Blob.sha256)
    of_export = packs.where(ExportPack.export_id == export.id).order_by(ExportPack.ordinal)
    index = session.get_one(Blob, export.index_sha256)
    return ExportLocation(index.object_key, tuple(session.scalars(of_export)))


def stored_files(store: Store, located: ExportLocation) -> StoredFiles:
    """The files of an export; reads its index, so not within a transaction."""
    return StoredFiles(_index(store, located.index_key), located.pack_keys)


@lru_cache(maxsize=HELD)
def archive_of(files: PackedFiles, kind: Kind) -> Archive:
    """The archive of all the files, which are told apart as objects."""
    return layout(files.members, kind)


@lru_cache(maxsize=HELD)
def _index(store: Store, object_key: str) -> PackedFiles:
    """An object never changes, so neither does what was read of it."""
    return read_index(b"".join(store.read(object_key)))
