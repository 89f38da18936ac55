"""Sweeper chores of uploads: expire overdue uploads, settle whole ones, delete leftovers.

**Conventions.** Several sweepers may run beside the API: locked bytes are in use and skipped, and every change is a
compare-and-set. A row changes before its bytes are deleted. A turn processes a slice (`UploadCursor`), with one
transaction per upload and file operations outside of it.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import structlog
from sqlalchemy import ColumnElement, and_, exists, or_, select, tuple_
from sqlalchemy.orm import aliased

from services.runtime.database.transactions import Database
from services.runtime.orm import DatasetImport, RecordingFile, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.gc_holds import ListingWalk
from services.runtime.uploads.backends import UploadBackend, backend_of, backends
from services.runtime.uploads.completion import settle_if_whole
from services.runtime.uploads.errors import FileMismatchError, UploadLockedError
from services.runtime.uploads.rows import GONE, PART, is_waiting, leave

# The cursor of the uploads' sweep, which processes a bounded slice each time.
#
# **Conventions.** The number of waiting uploads and files is unbounded; the duration of a turn is bounded. Each walk
# continues from the end of its last turn, and restarts at the beginning after the last entry. Entries that failed are
# skipped until the next round. The process keeps the cursor in memory only.


SLICE = 1000
FILES = 2000
SHARE_S = 5.0
NEVER_NS = 2**63 - 1


@dataclass
class ExpiryWalk:
    """A walk through the waiting uploads, in the order of their expiry."""

    _after: tuple[int, str] = (0, "")

    def turn(self, database: Database, most: int, first_ns: int = 0, last_ns: int = NEVER_NS) -> Iterator[Upload]:
        """Yield up to `most` uploads that expire in [first, last]; later calls return the rest."""
        position = tuple_(Upload.expires_ns, Upload.id)
        ordered = select(Upload).where(is_waiting(), position > max(self._after, (first_ns, "")))
        ordered = ordered.where(Upload.expires_ns <= last_ns).order_by(Upload.expires_ns, Upload.id)
        with database.reading() as session:
            uploads = list(session.scalars(ordered.limit(most)))
        for upload in uploads:
            self._after = (upload.expires_ns, upload.id)
            yield upload
        if len(uploads) < most:
            self._after = (0, "")


@dataclass
class UploadCursor:
    """The positions of all walks: at most `slice_rows` uploads and `slice_files` files per backend in a turn.

    A turn hashes whole files again for up to `share_s`, and at least one file.
    """

    slice_rows: int = SLICE
    slice_files: int = FILES
    share_s: float = SHARE_S
    overdue: ExpiryWalk = field(default_factory=ExpiryWalk)
    unsettled: ExpiryWalk = field(default_factory=ExpiryWalk)
    _names: dict[type, ListingWalk[str]] = field(default_factory=dict)

    def until_s(self) -> float:
        """Return the end of this turn's share, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def names_in(self, backend: type) -> ListingWalk[str]:
        """Return the walk through the files of this kind of backend."""
        return self._names.setdefault(backend, ListingWalk())


BATCH = 500

log = structlog.get_logger(__name__)


def expire(platform: Platform, cursor: UploadCursor | None = None) -> int:
    """Expire overdue uploads, settle whole ones, delete superfluous bytes; return the number of expired uploads.

    It processes one slice of each kind after the `cursor`, or from the beginning.
    """
    cursor = cursor or UploadCursor()
    _settle(platform, cursor)
    overdue = cursor.overdue.turn(platform.database, cursor.slice_rows, last_ns=now_ns())
    expired = sum(_expire(platform, upload) for upload in overdue)
    for backend in backends(platform):
        _remove_superfluous(platform, backend, cursor)
    return expired


def _expire(platform: Platform, upload: Upload) -> bool:
    detail = "it expired before it was " + ("finished" if upload.state == "open" else "used")
    try:
        held = backend_of(platform, upload).hold(upload) if upload.state == "open" else None
    except UploadLockedError:
        return False
    except FileNotFoundError:
        held = None
    try:
        return _end_overdue(platform, upload, detail)
    finally:
        if held is not None:
            held.close()


def _end_overdue(platform: Platform, upload: Upload, detail: str) -> bool:
    """Expire the upload; return False if another process was first, or if new bytes extended its time."""
    with platform.database.transaction() as session:
        current = session.get_one(Upload, upload.id, with_for_update={"key_share": True})
        moved = current.expires_ns <= now_ns() and leave(session, upload, "expired", detail)
    if moved:
        backend_of(platform, upload).remove(upload.id)
    return moved


def _settle(platform: Platform, cursor: UploadCursor) -> None:
    """Settle uploads that have all their bytes but whose process died before it updated the row."""
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
    """Delete bytes of ended uploads, of uploads stored as blobs or deleted since, and bytes without a row."""
    names = cursor.names_in(type(backend)).turn(backend.holding(), cursor.slice_files)
    upload_ids = iter(dict.fromkeys(names))
    while batch := list(islice(upload_ids, BATCH)):
        for upload_id in _superfluous(platform, backend, batch):
            backend.remove(upload_id)


def _superfluous(platform: Platform, backend: UploadBackend, upload_ids: Sequence[str]) -> Iterator[str]:
    statement = select(Upload.id, _is_superfluous()).where(Upload.id.in_(upload_ids))
    with platform.database.reading() as session:
        known = {upload_id: is_superfluous for upload_id, is_superfluous in session.execute(statement)}
    for upload_id in upload_ids:
        if known[upload_id] if upload_id in known else backend.is_forgotten(upload_id):
            yield upload_id


def _is_superfluous() -> ColumnElement[bool]:
    """Return whether an upload ended without its bytes, or its user has them in the store or is deleted."""
    recorded = exists().where(RecordingFile.upload_id == Upload.id, RecordingFile.blob_sha256.is_(None))
    submitted = exists().where(SubmissionRow.upload_id == Upload.id, SubmissionRow.blob_sha256.is_(None))
    unread = (DatasetImport.blob_sha256.is_(None), DatasetImport.finished_ns.is_(None))
    imported = exists().where(DatasetImport.upload_id == Upload.id, *unread)
    whole = aliased(Upload)
    joining = exists().where(whole.id == Upload.target_id, whole.state == "open")
    used = or_(
        and_(Upload.purpose == PART, ~joining),
        and_(Upload.purpose == "recording", ~recorded),
        and_(Upload.purpose == "submission", ~submitted),
        and_(Upload.purpose == "dataset", ~imported),
    )
    return or_(Upload.state.in_(GONE), and_(Upload.state == "consumed", used))
