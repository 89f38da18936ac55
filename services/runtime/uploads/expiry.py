"""Sweeper chores of uploads: expire overdue ones, finish complete ones, delete leftovers.

**Conventions.** Several sweepers may run beside the API: what is locked is in use and left alone, every change is a
compare-and-set. A row changes before its bytes go; bytes whose row says that they should be gone are removed.
"""

import structlog
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import RecordingFile, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.backend import UploadBackend
from services.runtime.uploads.backends import backend_of, backends
from services.runtime.uploads.completion import settle_if_whole
from services.runtime.uploads.errors import FileMismatchError, UploadLockedError
from services.runtime.uploads.rows import GONE, leave

log = structlog.get_logger(__name__)


def expire(platform: Platform) -> int:
    """End what expired, settle what is whole, remove bytes that belong to nothing; how many uploads expired."""
    _settle(platform)
    expired = sum(_expire(platform, upload) for upload in _overdue(platform))
    for backend in backends(platform):
        _remove_superfluous(platform, backend)
    return expired


def _overdue(platform: Platform) -> list[Upload]:
    overdue = select(Upload).where(Upload.state.in_(("open", "complete")), Upload.expires_ns <= now_ns())
    with platform.database.reading() as session:
        return list(session.scalars(overdue.order_by(Upload.id).limit(1000)))


def _expire(platform: Platform, upload: Upload) -> bool:
    detail = "its time was over before it was " + ("finished" if upload.state == "open" else "used")
    try:
        held = backend_of(platform, upload).hold(upload) if upload.state == "open" else None
    except UploadLockedError:  # bytes are coming in
        return False
    except FileNotFoundError:
        held = None
    try:
        return _end_overdue(platform, upload, detail)
    finally:
        if held is not None:
            held.close()


def _end_overdue(platform: Platform, upload: Upload, detail: str) -> bool:
    """False when somebody else was first, or bytes came in and put its end off."""
    with platform.database.transaction() as session:
        current = session.get_one(Upload, upload.id, with_for_update={"key_share": True})
        moved = current.expires_ns <= now_ns() and leave(session, upload, "expired", detail)
    if moved:
        backend_of(platform, upload).remove(upload.id)
    return moved


def _settle(platform: Platform) -> None:
    """Uploads that have all their bytes but whose process died before it could say so."""
    with platform.database.reading() as session:
        uploads = list(session.scalars(select(Upload).where(Upload.state == "open", Upload.expires_ns > now_ns())))
    for upload in uploads:
        try:
            settle_if_whole(platform, upload)
        except FileMismatchError as mismatch:
            log.warning("upload refused", upload_id=upload.id, reason=str(mismatch))
        except FileNotFoundError:
            log.warning("upload without a file", upload_id=upload.id)


def _remove_superfluous(platform: Platform, backend: UploadBackend) -> None:
    """Bytes of ended uploads, of what is kept as blobs or gone, and of uploads that never were."""
    for upload_id in backend.holding():
        with platform.database.reading() as session:
            upload = session.get(Upload, upload_id)
            is_superfluous = backend.is_forgotten(upload_id) if upload is None else _is_needed_no_more(session, upload)
        if is_superfluous:
            backend.remove(upload_id)


def _is_needed_no_more(session: Session, upload: Upload) -> bool:
    """Whether it ended without its bytes, or what used it has its bytes in the store or is gone."""
    if upload.state != "consumed" or upload.purpose not in ("recording", "submission"):
        return upload.state in GONE
    recorded = select(RecordingFile.blob_sha256).where(RecordingFile.upload_id == upload.id)
    submitted = select(SubmissionRow.blob_sha256).where(SubmissionRow.upload_id == upload.id)
    used = session.scalars(recorded if upload.purpose == "recording" else submitted).all()
    return None not in used
