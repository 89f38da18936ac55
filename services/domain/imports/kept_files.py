"""Files of a dataset that belong to no table: stored with its import, counted against the owner, downloadable.

**Conventions.** They are rows of the import and stay until it is deleted. They belong to the dataset and not to a
scene: a viewer of one sequence of an import cannot read files that may describe all scenes.
"""

from collections.abc import Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access import storage_quota
from services.runtime.orm import Blob, DatasetImport, ImportedFile
from stone.errors import Refused

OF_NO_SCENE = -1
TYPE = "application/octet-stream"


def keep_file(session: Session, imported: DatasetImport, name: str, blob: Blob) -> None:
    """Add a file to the import."""
    row = ImportedFile(import_id=imported.id, scene=OF_NO_SCENE, name=name, media_type=TYPE)
    row.blob_sha256, row.size_bytes = blob.sha256, blob.size_bytes
    session.add(row)
    session.flush()


def kept_files(session: Session, imported: DatasetImport) -> Sequence[ImportedFile]:
    """Return the import's files, by name."""
    of_import = (ImportedFile.import_id == imported.id, ImportedFile.scene == OF_NO_SCENE)
    return session.scalars(select(ImportedFile).where(*of_import).order_by(ImportedFile.name)).all()


def kept_file(session: Session, imported: DatasetImport, name: str) -> tuple[ImportedFile, Blob]:
    """Return the file with this name. Raises `not_found`."""
    row = session.get(ImportedFile, (imported.id, OF_NO_SCENE, name))
    if row is None:
        raise Refused("not_found", f"import {imported.id} has no file {name[:200]!r}")
    return row, session.get_one(Blob, row.blob_sha256)


def count_kept(session: Session, imported: DatasetImport, limit_bytes: int) -> None:
    """Count the files against the owner. Raises `quota_exceeded`."""
    size_bytes = sum(file.size_bytes for file in kept_files(session, imported))
    if size_bytes:
        storage_quota.reserve(session, imported.owner_id, size_bytes, imported.id, "kept files", limit_bytes)
