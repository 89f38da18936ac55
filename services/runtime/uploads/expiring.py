"""The sweeper's part: uploads whose time is over end, those that only lack their last step are given it.

**Conventions.** Several sweepers may run beside the API: what is locked is in use and left alone, every change is a
compare-and-set. A row changes before its file goes; a file whose row says that it should be gone is removed.
"""

import re
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import structlog
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import RecordingFile, Submission, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.errors import FileMismatchError, UploadLockedError
from services.runtime.uploads.files import HeldFile, remove_file, upload_file
from services.runtime.uploads.finishing import end, settle_if_whole
from services.runtime.uploads.rows import GONE

log = structlog.get_logger(__name__)

OURS = re.compile(r"([0-9a-f]{32})(?:\.unverified)?")
ORPHAN_S = 3600.0


def expire(platform: Platform) -> int:
    """End what expired, settle what is whole, remove files that belong to nothing; how many uploads expired."""
    _settle(platform)
    expired = sum(_expire(platform, upload) for upload in _overdue(platform))
    for path in _superfluous(platform):
        remove_file(path)
    return expired


def _overdue(platform: Platform) -> list[Upload]:
    overdue = select(Upload).where(Upload.state.in_(("open", "complete")), Upload.expires_ns <= now_ns())
    with platform.database.reading() as session:
        return list(session.scalars(overdue.order_by(Upload.id).limit(1000)))


def _expire(platform: Platform, upload: Upload) -> bool:
    detail = "its time was over before it was " + ("finished" if upload.state == "open" else "used")
    try:
        held = HeldFile(upload_file(platform.settings, upload.id)) if upload.state == "open" else None
    except UploadLockedError:  # bytes are coming in
        return False
    except FileNotFoundError:
        held = None
    try:
        return end(platform, upload, "expired", detail)
    finally:
        if held is not None:
            held.close()


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


def _superfluous(platform: Platform) -> Iterator[Path]:
    """Files of ended uploads, of what is kept as blobs or gone, and of uploads that never were."""
    folder = platform.settings.uploads_folder
    found = {match[1] for path in _listed(folder) if (match := OURS.fullmatch(path.name))}
    for upload_id in sorted(found):
        path = upload_file(platform.settings, upload_id)
        with platform.database.reading() as session:
            upload = session.get(Upload, upload_id)
            is_superfluous = _is_old(path) if upload is None else _is_needed_no_more(session, upload)
        if is_superfluous:
            yield path


def _is_needed_no_more(session: Session, upload: Upload) -> bool:
    """Whether it ended without a file, or what used it has its bytes in the store or is gone."""
    if upload.state != "consumed" or upload.purpose not in ("recording", "submission"):
        return upload.state in GONE
    recorded = select(RecordingFile.blob_sha256).where(RecordingFile.upload_id == upload.id)
    submitted = select(Submission.blob_sha256).where(Submission.upload_id == upload.id)
    used = session.scalars(recorded if upload.purpose == "recording" else submitted).all()
    return None not in used


def _listed(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _is_old(path: Path) -> bool:
    with suppress(FileNotFoundError):
        return time.time() - path.stat().st_mtime > ORPHAN_S
    return True
