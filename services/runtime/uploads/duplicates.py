"""Finds an owner's existing files of equal content, so that bytes are not sent twice.

**Conventions.** What others have is never looked at. A file may go while it is looked at: whoever links it tries the
next one.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.runtime.orm import Blob, Recording, RecordingFile, SequenceRow, SubmissionRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.folder import FolderStore
from services.runtime.store.keys import ObjectMissingError
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.rows import WHOLE

MOST = 8


def duplicates_of(platform: Platform, upload: Upload) -> Iterator[Path]:
    """Files with the declared bytes on this machine: uploads, then what is kept of them in a folder."""
    with platform.database.reading() as session:
        ids = session.scalars(uploads_like(upload).order_by(Upload.id.desc()).limit(MOST)).all()
        blob = kept_blob(session, upload)
    yield from (upload_file(platform.settings, duplicate_id) for duplicate_id in ids)
    if blob is not None and isinstance(platform.store, FolderStore):
        with suppress(ObjectMissingError):
            yield platform.store.local(blob.object_key)


def uploads_like(upload: Upload) -> Select[str]:
    """The ids of its owner's whole uploads of the declared bytes."""
    return select(Upload.id).where(
        Upload.owner_id == upload.owner_id,
        Upload.sha256 == upload.declared_sha256,
        Upload.length_bytes == upload.length_bytes,
        Upload.state.in_(WHOLE),
    )


def kept_blob(session: Session, upload: Upload) -> Blob | None:
    """The blob of a recording, or of a submission that the owner sent."""
    found = select(Blob).where(Blob.sha256 == upload.declared_sha256, Blob.size_bytes == upload.length_bytes)
    recorded = (
        found.join(RecordingFile, RecordingFile.blob_sha256 == Blob.sha256)
        .join(Recording, Recording.id == RecordingFile.recording_id)
        .join(SequenceRow, SequenceRow.id == Recording.sequence_id)
        .where(SequenceRow.owner_id == upload.owner_id, SequenceRow.deleted_ns.is_(None))
    )
    submitted = (
        found.join(SubmissionRow, SubmissionRow.blob_sha256 == Blob.sha256)
        .join(Upload, Upload.id == SubmissionRow.upload_id)
        .where(Upload.owner_id == upload.owner_id)
    )
    return session.scalar(recorded.limit(1)) or session.scalar(submitted.limit(1))
