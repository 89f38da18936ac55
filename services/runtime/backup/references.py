"""What a database state refers to outside of it: blobs, work files of unfinished runs, uploads under way.

**Conventions.** Asked within the snapshot's own transaction, except for what may be much: blobs and upload parts (bytes
under way that lie in the store) are read from the rows that were written. Of uploads only those in the folder are told.
A run is over when it succeeded, or failed so long ago that its work is not kept (`garbage_collection`).
"""

from dataclasses import dataclass

from sqlalchemy import Connection, and_, or_, select

from services.runtime.orm import DatasetImport, Job, RecordingFile, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.store.garbage_collection import KEPT_FAILED_NS
from services.runtime.uploads.part_rows import STORE


@dataclass(frozen=True)
class BackupUpload:
    """An upload whose bytes lie in the folder only; `sha256` is empty until all of them are there."""

    id: str
    sha256: str


@dataclass(frozen=True)
class BackupReferences:
    """Ids of the runs whose work is needed, and the uploads whose bytes are."""

    runs: frozenset[str]
    uploads: tuple[BackupUpload, ...]


def backup_references(connection: Connection) -> BackupReferences:
    return BackupReferences(frozenset(_runs(connection)), tuple(_uploads(connection)))


def _runs(connection: Connection) -> list[str]:
    kept_ns = now_ns() - KEPT_FAILED_NS
    needed = or_(Job.finished_ns.is_(None), (Job.state != "succeeded") & (Job.finished_ns > kept_ns))
    return list(connection.scalars(select(Job.id).where(Job.id == Job.root_id, needed)))


def _uploads(connection: Connection) -> list[BackupUpload]:
    """Uploads under way or whole, and those of which whoever used them has no blob yet."""
    used = Upload.state == "consumed"
    recorded = select(RecordingFile.upload_id).where(RecordingFile.blob_sha256.is_(None))
    submitted = select(SubmissionRow.upload_id).where(SubmissionRow.blob_sha256.is_(None))
    unread = (DatasetImport.blob_sha256.is_(None), DatasetImport.finished_ns.is_(None))
    imported = select(DatasetImport.upload_id).where(*unread)
    needed = or_(
        Upload.state.in_(("open", "complete")),
        and_(used, Upload.purpose.not_in(("recording", "submission", "dataset"))),
        and_(used, Upload.purpose == "recording", Upload.id.in_(recorded)),
        and_(used, Upload.purpose == "submission", Upload.id.in_(submitted)),
        and_(used, Upload.purpose == "dataset", Upload.id.in_(imported)),
    )
    found = connection.execute(
        select(Upload.id, Upload.sha256).where(Upload.backend != STORE, needed).order_by(Upload.id)
    )
    return [BackupUpload(upload_id, sha256) for upload_id, sha256 in found]
