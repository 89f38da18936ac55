"""Upload rows: selected by owner, moved between states by compare-and-set.

**Conventions.** States: open, then complete (all bytes present, sha256 known), then consumed; or failed, expired,
terminated, without bytes or quota. To change `open`, a process must hold the upload's bytes. The compare-and-set alone
decides complete → consumed and complete → expired.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from sqlalchemy import ColumnElement, CursorResult, Select, literal_column, select, update
from sqlalchemy.orm import Session

from services.runtime.access.storage_quota import release
from services.runtime.database.transactions import Database
from services.runtime.orm import Blob, Recording, RecordingFile, SequenceRow, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.folder import FolderStore
from services.runtime.store.keys import ObjectMissingError
from services.runtime.uploads.errors import upload_gone, upload_state
from services.runtime.uploads.files import upload_file
from stone.errors import Refused

PART = "part"
"""The purpose of an upload that will be joined with others (`joining.py`)."""
WHOLE = ("complete", "consumed")
GONE = ("failed", "expired", "terminated")


@dataclass(frozen=True)
class UploadOwner:
    """The owner of an upload. Administrators may also name other users' targets; participants have their own quota."""

    user_id: str
    is_administrator: bool = False
    is_participant: bool = False


def expiry_ns(platform: Platform) -> int:
    """Return the expiry time of an upload that is used now."""
    return now_ns() + int(platform.settings.uploads.expires_s * 1e9)


def is_waiting() -> ColumnElement[bool]:
    """Return whether an upload is unfinished, or finished and unused. The literals match the partial indexes."""
    return Upload.state.in_([literal_column("'open'"), literal_column("'complete'")])


def find(database: Database, upload_id: str, owner_id: str) -> Upload:
    """Return the owner's upload. Raises `upload_missing`, also for another user's upload."""
    with database.reading() as session:
        upload = session.get(Upload, upload_id)
    if upload is None or upload.owner_id != owner_id:
        raise Refused("upload_missing", f"you have no upload {upload_id[:64]!r}")
    return upload


def find_alive(database: Database, upload_id: str, owner_id: str) -> Upload:
    """Return the owner's upload if it has or expects bytes. Raises `upload_missing`, `upload_gone`."""
    upload = find(database, upload_id, owner_id)
    refuse_gone(upload)
    return upload


def refuse_gone(upload: Upload) -> None:
    """Raise `upload_gone`, also for an overdue upload that is not swept yet."""
    if upload.state in GONE:
        raise upload_gone(upload.id, upload.state, upload.detail)
    if upload.state == "open" and upload.expires_ns <= now_ns():
        raise upload_gone(upload.id, "expired", "it was not finished in time")


def move(session: Session, upload: Upload, state: str, **columns: Any) -> bool:
    """Move from the state `upload` shows by compare-and-set; return False if another process was first."""
    held = update(Upload).where(Upload.id == upload.id, Upload.state == upload.state)
    result = session.execute(held.values(state=state, **columns), execution_options={"synchronize_session": False})
    return cast("CursorResult[None]", result).rowcount == 1


def leave(session: Session, upload: Upload, state: str, detail: str = "") -> bool:
    """Move to a state without bytes and release the quota; return False if another process was first."""
    moved = move(session, upload, state, detail=detail[:512])
    if moved:
        release(session, upload.id, state)
    return moved


def consume(session: Session, upload_id: str, owner_id: str, purpose: str) -> Upload:
    """Use a complete upload for its purpose, once; its bytes stay in place and its quota stays reserved.

    Raises `upload_missing`, `wrong_upload_purpose`, `wrong_upload_state`.
    """
    upload = session.scalar(select(Upload).where(Upload.id == upload_id, Upload.owner_id == owner_id).with_for_update())
    if upload is None:
        raise Refused("upload_missing", f"you have no upload {upload_id[:64]!r}")
    if upload.purpose != purpose:
        raise Refused(
            "wrong_upload_purpose", f"upload {upload_id} was declared as a {upload.purpose}, not as a {purpose}"
        )
    session.refresh(upload)
    if upload.state != "complete" or not move(session, upload, "consumed"):
        raise upload_state(upload_id, upload.state, "used", "complete")
    session.refresh(upload)
    return upload


# Find an owner's existing files of equal content, so that bytes are not sent twice.
#
# **Conventions.** Other owners' files are never compared. A file may be deleted meanwhile: the caller then tries the
# next one.


MOST = 8


def duplicates_of(platform: Platform, upload: Upload) -> Iterator[Path]:
    """Yield local files with the declared bytes: uploads, then blobs of a folder store."""
    with platform.database.reading() as session:
        ids = session.scalars(uploads_like(upload).order_by(Upload.id.desc()).limit(MOST)).all()
        blob = kept_blob(session, upload)
    yield from (upload_file(platform.settings, duplicate_id) for duplicate_id in ids)
    if blob is not None and isinstance(platform.store, FolderStore):
        with suppress(ObjectMissingError):
            yield platform.store.local(blob.object_key)


def uploads_like(upload: Upload) -> Select[str]:
    """Return the ids of the owner's whole uploads with the declared bytes."""
    return select(Upload.id).where(
        Upload.owner_id == upload.owner_id,
        Upload.sha256 == upload.declared_sha256,
        Upload.length_bytes == upload.length_bytes,
        Upload.state.in_(WHOLE),
    )


def kept_blob(session: Session, upload: Upload) -> Blob | None:
    """Return the blob of the owner's recording or submission with the declared bytes."""
    declared = select(Blob).where(Blob.sha256 == upload.declared_sha256, Blob.size_bytes == upload.length_bytes)
    recorded = (
        declared.join(RecordingFile, RecordingFile.blob_sha256 == Blob.sha256)
        .join(Recording, Recording.id == RecordingFile.recording_id)
        .join(SequenceRow, SequenceRow.id == Recording.sequence_id)
        .where(SequenceRow.owner_id == upload.owner_id, SequenceRow.deleted_ns.is_(None))
    )
    submitted = (
        declared.join(SubmissionRow, SubmissionRow.blob_sha256 == Blob.sha256)
        .join(Upload, Upload.id == SubmissionRow.upload_id)
        .where(Upload.owner_id == upload.owner_id)
    )
    return session.scalar(recorded.limit(1)) or session.scalar(submitted.limit(1))
