"""Upload rows: found by owner, moved between states by compare-and-set.

**Conventions.** States: open, then complete (all bytes there, sha256 known), then consumed; or failed, expired,
terminated, which have no bytes and hold no quota. Whoever changes `open` holds the upload's bytes; complete → consumed
and complete → expired are decided by the compare-and-set alone.
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
"""The purpose of an upload that is to be joined with others (`joining.py`)."""
WHOLE = ("complete", "consumed")
GONE = ("failed", "expired", "terminated")


@dataclass(frozen=True)
class UploadOwner:
    """For whom; administrators may also name targets of others, participants have a quota of their own."""

    user_id: str
    is_administrator: bool = False
    is_participant: bool = False


def expiry_ns(platform: Platform) -> int:
    """When an upload that is touched now expires."""
    return now_ns() + int(platform.settings.uploads.expires_s * 1e9)


def is_waiting() -> ColumnElement[bool]:
    """Whether an upload is unfinished, or finished and not used yet; in the literals that its partial indexes know."""
    return Upload.state.in_([literal_column("'open'"), literal_column("'complete'")])


def find(database: Database, upload_id: str, owner_id: str) -> Upload:
    """The owner's upload. Raises `upload_missing`, also for one that is somebody else's."""
    with database.reading() as session:
        upload = session.get(Upload, upload_id)
    if upload is None or upload.owner_id != owner_id:
        raise Refused("upload_missing", f"you have no upload {upload_id[:64]!r}")
    return upload


def find_alive(database: Database, upload_id: str, owner_id: str) -> Upload:
    """The owner's upload, which has or awaits its bytes. Raises `upload_missing`, `upload_gone`."""
    upload = find(database, upload_id, owner_id)
    refuse_gone(upload)
    return upload


def refuse_gone(upload: Upload) -> None:
    """Raises `upload_gone`, also for one whose time is over but that was not swept yet."""
    if upload.state in GONE:
        raise upload_gone(upload.id, upload.state, upload.detail)
    if upload.state == "open" and upload.expires_ns <= now_ns():
        raise upload_gone(upload.id, "expired", "it was not finished in time")


def move(session: Session, upload: Upload, state: str, **columns: Any) -> bool:
    """Compare-and-set from the state `upload` shows; false when somebody else was first."""
    held = update(Upload).where(Upload.id == upload.id, Upload.state == upload.state)
    result = session.execute(held.values(state=state, **columns), execution_options={"synchronize_session": False})
    return cast("CursorResult[None]", result).rowcount == 1


def leave(session: Session, upload: Upload, state: str, detail: str = "") -> bool:
    """Move to a state without bytes and give the quota back; false when somebody else was first."""
    moved = move(session, upload, state, detail=detail[:512])
    if moved:
        release(session, upload.id, state)
    return moved


def consume(session: Session, upload_id: str, owner_id: str, purpose: str) -> Upload:
    """Take a complete upload for its purpose, once; its bytes stay where they are and its quota stays taken.

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


# Finds an owner's existing files of equal content, so that bytes are not sent twice.
#
# **Conventions.** What others have is never looked at. A file may go while it is looked at: whoever links it tries the
# next one.


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
