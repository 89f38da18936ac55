"""Sweeper chores of uploads: expire overdue ones, finish complete ones, delete leftovers.

**Conventions.** Several sweepers may run beside the API: what is locked is in use and left alone, every change is a
compare-and-set. A row changes before its bytes go; bytes whose row says that they should be gone are removed. A turn
looks at a slice of all there is (`sweep_cursor`), each upload in a transaction of its own, files outside of it.
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

# The cursor of the uploads' sweep, which looks at some of very many uploads each time.
#
# **Conventions.** How many uploads wait, and how many files lie about, is up to whoever uploads; how long a turn takes
# is not. Each walk goes on where its last turn ended, and from the beginning once it came to the end. What could not
# be dealt with is passed by and looked at again in the next round. Where a turn ended is forgotten with the process.


SLICE = 1000
FILES = 2000
SHARE_S = 5.0
NEVER_NS = 2**63 - 1


@dataclass
class ExpiryWalk:
    """A walk through the uploads that wait, in the order in which they expire."""

    _after: tuple[int, str] = (0, "")

    def turn(self, database: Database, most: int, first_ns: int = 0, last_ns: int = NEVER_NS) -> Iterator[Upload]:
        """At most so many of those that expire within [first, last]; one that is not asked for comes next time."""
        place = tuple_(Upload.expires_ns, Upload.id)
        ordered = select(Upload).where(is_waiting(), place > max(self._after, (first_ns, "")))
        ordered = ordered.where(Upload.expires_ns <= last_ns).order_by(Upload.expires_ns, Upload.id)
        with database.reading() as session:
            found = list(session.scalars(ordered.limit(most)))
        for upload in found:
            self._after = (upload.expires_ns, upload.id)
            yield upload
        if len(found) < most:
            self._after = (0, "")


@dataclass
class UploadCursor:
    """Where each walk goes on: `slice_rows` uploads and `slice_files` files of a backend a turn, at most.

    Files that are whole are read again for `share_s` a turn, and one of them at least.
    """

    slice_rows: int = SLICE
    slice_files: int = FILES
    share_s: float = SHARE_S
    overdue: ExpiryWalk = field(default_factory=ExpiryWalk)
    unsettled: ExpiryWalk = field(default_factory=ExpiryWalk)
    _names: dict[type, ListingWalk[str]] = field(default_factory=dict)

    def until_s(self) -> float:
        """When this turn's share will be used up, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def names_in(self, backend: type) -> ListingWalk[str]:
        """The walk through the files of a kind of backend."""
        return self._names.setdefault(backend, ListingWalk())


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
    detail = "it expired before it was " + ("finished" if upload.state == "open" else "used")
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
    whole = aliased(Upload)
    joining = exists().where(whole.id == Upload.target_id, whole.state == "open")
    used = or_(
        and_(Upload.purpose == PART, ~joining),
        and_(Upload.purpose == "recording", ~recorded),
        and_(Upload.purpose == "submission", ~submitted),
        and_(Upload.purpose == "dataset", ~imported),
    )
    return or_(Upload.state.in_(GONE), and_(Upload.state == "consumed", used))
