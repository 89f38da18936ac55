"""Files that an owner has here already, so that the same bytes need not be sent twice.

**Conventions.** What others have is never looked at. A file may go while it is looked at: whoever links it tries the
next one.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.runtime.orm import Blob, Recording, RecordingFile, Sequence, Submission, Upload
from services.runtime.platform import Platform
from services.runtime.store_folder import FolderStore
from services.runtime.store_keys import ObjectMissingError
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.rows import WHOLE

MOST = 8


def twins_of(platform: Platform, upload: Upload) -> Iterator[Path]:
    """Files with the declared bytes on this machine: uploads, then what is kept of them in a folder."""
    with platform.database.reading() as session:
        ids = session.scalars(_uploads(upload).order_by(Upload.id.desc()).limit(MOST)).all()
        object_key = _kept(session, upload)
    yield from (upload_file(platform.settings, twin_id) for twin_id in ids)
    if object_key is not None and isinstance(platform.store, FolderStore):
        with suppress(ObjectMissingError):
            yield platform.store.local(object_key)


def _uploads(upload: Upload) -> Select[str]:
    return select(Upload.id).where(
        Upload.owner_id == upload.owner_id,
        Upload.sha256 == upload.declared_sha256,
        Upload.length_bytes == upload.length_bytes,
        Upload.state.in_(WHOLE),
    )


def _kept(session: Session, upload: Upload) -> str | None:
    """The key of the blob of a recording, or of a submission that the owner sent."""
    found = select(Blob.object_key).where(Blob.sha256 == upload.declared_sha256, Blob.size_bytes == upload.length_bytes)
    recorded = (
        found.join(RecordingFile, RecordingFile.blob_sha256 == Blob.sha256)
        .join(Recording, Recording.id == RecordingFile.recording_id)
        .join(Sequence, Sequence.id == Recording.sequence_id)
        .where(Sequence.owner_id == upload.owner_id, Sequence.deleted_ns.is_(None))
    )
    submitted = (
        found.join(Submission, Submission.blob_sha256 == Blob.sha256)
        .join(Upload, Upload.id == Submission.upload_id)
        .where(Upload.owner_id == upload.owner_id)
    )
    return session.scalar(recorded.limit(1)) or session.scalar(submitted.limit(1))
