"""An upload comes to be: its file first, then its row with the quota it takes.

**Conventions.** A file without a row is swept (`expiring`), a row without a file is never made. A file the owner has
already is not sent again: the new upload gets a second name for the same bytes on disk and is complete at once. What
others have is never looked at, so nothing can be learnt about it.
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from sqlalchemy import select

from services.runtime.orm import Blob, Recording, RecordingFile, Sequence, Upload, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.quota import reserve
from services.runtime.store_folder import FolderStore
from services.runtime.store_keys import ObjectMissingError
from services.runtime.uploads.declared import Declared
from services.runtime.uploads.errors import UploadTargetMissingError, UploadTooLargeError
from services.runtime.uploads.files import make_file, remove_file, sync_folder, upload_file
from services.runtime.uploads.rows import WHOLE, Owner


def create(platform: Platform, owner: Owner, declared: Declared) -> Upload:
    """A new upload, open, or complete when the owner has these bytes already.

    Raises `UploadTooLargeError`, `UploadTargetMissingError`, `QuotaExceededError`, `DiskFullError`.
    """
    limit_bytes = platform.settings.uploads.max_bytes
    if declared.length_bytes > limit_bytes:
        raise UploadTooLargeError(declared.length_bytes, limit_bytes)
    _refuse_foreign_target(platform, owner, declared)
    upload = _row(platform, owner, declared)
    path = upload_file(platform.settings, upload.id)
    if _link_twin(platform, upload, path):
        upload.state, upload.sha256 = "complete", declared.sha256
    else:
        make_file(path)
    try:
        with platform.database.transaction() as session:
            limit_bytes = platform.settings.uploads.owner_bytes
            reserve(session, owner.user_id, upload.length_bytes, upload.id, "upload", limit_bytes)
            session.add(upload)
    except BaseException:
        remove_file(path)
        raise
    return upload


def expiry_ns(platform: Platform) -> int:
    """When an upload that is touched now expires."""
    return now_ns() + int(platform.settings.uploads.expires_s * 1e9)


def _row(platform: Platform, owner: Owner, declared: Declared) -> Upload:
    return Upload(
        id=new_id(),
        owner_id=owner.user_id,
        purpose=declared.purpose,
        target_id=declared.target_id,
        filename=declared.filename,
        length_bytes=declared.length_bytes,
        declared_sha256=declared.sha256,
        state="open",
        sha256="",
        detail="",
        created_ns=now_ns(),
        expires_ns=expiry_ns(platform),
    )


def _refuse_foreign_target(platform: Platform, owner: Owner, declared: Declared) -> None:
    """A recording for a sequence that is not there would be found out only after hours of sending."""
    if declared.purpose != "recording" or not declared.target_id:
        return
    with platform.database.reading() as session:
        sequence = session.get(Sequence, declared.target_id)
    is_theirs = sequence is not None and (owner.is_administrator or sequence.owner_id == owner.user_id)
    if sequence is None or not is_theirs or sequence.deleted_ns is not None:
        raise UploadTargetMissingError(declared.purpose, declared.target_id)


def _link_twin(platform: Platform, upload: Upload, path: Path) -> bool:
    """Whether the owner had the declared bytes already, and `path` names them now."""
    if not upload.declared_sha256:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    for twin in _twins(platform, upload):
        try:
            os.link(twin, path)
        except OSError:  # consumed or collected meanwhile, or on another filesystem: then it is sent again
            continue
        sync_folder(path.parent)
        return True
    return False


def _twins(platform: Platform, upload: Upload) -> Iterator[Path]:
    """Files on this machine with the declared bytes that are the owner's: uploads, then recordings kept in a folder."""
    sha256, length_bytes = upload.declared_sha256, upload.length_bytes
    with platform.database.reading() as session:
        uploads = select(Upload.id).where(
            Upload.owner_id == upload.owner_id,
            Upload.sha256 == sha256,
            Upload.length_bytes == length_bytes,
            Upload.state.in_(WHOLE),
        )
        ids = session.scalars(uploads.order_by(Upload.id.desc()).limit(8)).all()
        recorded = (
            select(Blob.object_key)
            .join(RecordingFile, RecordingFile.blob_sha256 == Blob.sha256)
            .join(Recording, Recording.id == RecordingFile.recording_id)
            .join(Sequence, Sequence.id == Recording.sequence_id)
            .where(Sequence.owner_id == upload.owner_id, Sequence.deleted_ns.is_(None))
            .where(Blob.sha256 == sha256, Blob.size_bytes == length_bytes)
        )
        object_key = session.scalar(recorded.limit(1))
    yield from (upload_file(platform.settings, twin_id) for twin_id in ids)
    if object_key is not None and isinstance(platform.store, FolderStore):
        with suppress(ObjectMissingError):
            yield platform.store.local(object_key)
