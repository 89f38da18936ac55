"""Sweeper chores of uploads: expire overdue ones, finish complete ones, delete leftovers.

**Conventions.** Several sweepers may run beside the API: what is locked is in use and left alone, every change is a
compare-and-set. A row changes before its bytes go; bytes whose row says that they should be gone are removed. A turn
looks at a slice of all there is (`sweep_cursor`), each upload in a transaction of its own, files outside of it.
"""

import time
from collections.abc import Iterator, Sequence
from itertools import islice

import structlog
from sqlalchemy import ColumnElement, and_, exists, or_, select

from services.runtime.orm import DatasetImport, RecordingFile, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.backend import UploadBackend
from services.runtime.uploads.backends import backend_of, backends
from services.runtime.uploads.completion import settle_if_whole
from services.runtime.uploads.errors import FileMismatchError, UploadLockedError
from services.runtime.uploads.rows import GONE, leave
from services.runtime.uploads.sweep_cursor import UploadCursor

BATCH = 500

log = structlog.get_logger(__name__)


def expire(platform: Platform, cursor: UploadCursor | None = None) -> int:
    """End what expired, settle what is whole, remove bytes that belong to nothing; how many uploads expired.

    Some of each: what comes after the `cursor`, or from the beginning.
    """
    cursor = cursor or UploadCursor()
    _settle(platform, cursor)
    overdue = cursor.overdue.turn(platform.database, cursor.slice_rows, last_ns=now_ns())
    expired = sum(_expire(platform, upload) for upload in overdue)
    for backend in backends(platform):
        _remove_superfluous(platform, backend, cursor)
    return expired


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


def _settle(platform: Platform, cursor: UploadCursor) -> None:
    """Uploads that have all their bytes but whose process died before it could say so."""
    until_s = cursor.until_s()
    for upload in cursor.unsettled.turn(platform.database, cursor.slice_rows, first_ns=now_ns()):
        try:
            settle_if_whole(platform, upload)
        except FileMismatchError as mismatch:
            log.warning("upload refused", upload_id=upload.id, reason=str(mismatch))
        except FileNotFoundError:
            log.warning("upload without a file", upload_id=upload.id)
        if time.monotonic() >= until_s:
            return


def _remove_superfluous(platform: Platform, backend: UploadBackend, cursor: UploadCursor) -> None:
    """Bytes of ended uploads, of what is kept as blobs or gone, and of uploads that never were."""
    names = cursor.names_in(type(backend)).turn(backend.holding(), cursor.slice_files)
    upload_ids = iter(dict.fromkeys(names))
    while batch := list(islice(upload_ids, BATCH)):
        for upload_id in _superfluous(platform, backend, batch):
            backend.remove(upload_id)


def _superfluous(platform: Platform, backend: UploadBackend, upload_ids: Sequence[str]) -> Iterator[str]:
    asked = select(Upload.id, _is_needed_no_more()).where(Upload.id.in_(upload_ids))
    with platform.database.reading() as session:
        known = {upload_id: is_superfluous for upload_id, is_superfluous in session.execute(asked)}
    for upload_id in upload_ids:
        if known[upload_id] if upload_id in known else backend.is_forgotten(upload_id):
            yield upload_id


def _is_needed_no_more() -> ColumnElement[bool]:
    """Whether an upload ended without its bytes, or what used it has its bytes in the store or is gone."""
    recorded = exists().where(RecordingFile.upload_id == Upload.id, RecordingFile.blob_sha256.is_(None))
    submitted = exists().where(SubmissionRow.upload_id == Upload.id, SubmissionRow.blob_sha256.is_(None))
    unread = (DatasetImport.blob_sha256.is_(None), DatasetImport.finished_ns.is_(None))
    imported = exists().where(DatasetImport.upload_id == Upload.id, *unread)
    used = or_(
        and_(Upload.purpose == "recording", ~recorded),
        and_(Upload.purpose == "submission", ~submitted),
        and_(Upload.purpose == "dataset", ~imported),
    )
    return or_(Upload.state.in_(GONE), and_(Upload.state == "consumed", used))
