"""An upload comes to be: its file first, then its row with the quota it takes.

**Conventions.** A file without a row is swept (`expiring`), a row without a file is never made. A file the owner has
already is not sent again: the new upload gets a second name for the same bytes on disk and is complete at once. What
others have is never looked at, so nothing can be learnt about it.
"""

import os
from pathlib import Path

from services.runtime.orm import Upload, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.quota import reserve
from services.runtime.uploads.declared import Declared
from services.runtime.uploads.errors import UploadTooLargeError
from services.runtime.uploads.files import make_file, remove_file, sync_folder, upload_file
from services.runtime.uploads.rows import Owner
from services.runtime.uploads.targets import refuse_foreign_target
from services.runtime.uploads.twins import twins_of


def create(platform: Platform, owner: Owner, declared: Declared) -> Upload:
    """A new upload, open, or complete when the owner has these bytes already.

    Raises `UploadTooLargeError`, `UploadTargetMissingError`, `UndeclaredUploadError`, `QuotaExceededError`,
    `DiskFullError`.
    """
    limit_bytes = platform.settings.uploads.max_bytes
    if declared.length_bytes > limit_bytes:
        raise UploadTooLargeError(declared.length_bytes, limit_bytes)
    refuse_foreign_target(platform, owner, declared)
    upload = _row(platform, owner, declared)
    path = upload_file(platform.settings, upload.id)
    if _link_twin(platform, upload, path):
        upload.state, upload.sha256 = "complete", declared.sha256
    else:
        make_file(path)
    try:
        with platform.database.transaction() as session:
            limit_bytes = owner_limit_bytes(platform, owner)
            reserve(session, owner.user_id, upload.length_bytes, upload.id, "upload", limit_bytes)
            session.add(upload)
    except BaseException:
        remove_file(path)
        raise
    return upload


def expiry_ns(platform: Platform) -> int:
    """When an upload that is touched now expires."""
    return now_ns() + int(platform.settings.uploads.expires_s * 1e9)


def owner_limit_bytes(platform: Platform, owner: Owner) -> int:
    """What the owner may have stored or under way."""
    settings = platform.settings
    return settings.submissions.participant_bytes if owner.is_participant else settings.uploads.owner_bytes


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


def _link_twin(platform: Platform, upload: Upload, path: Path) -> bool:
    """Whether the owner had the declared bytes already, and `path` names them now."""
    if not upload.declared_sha256:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    for twin in twins_of(platform, upload):
        try:
            os.link(twin, path)
        except OSError:  # consumed or collected meanwhile, or on another filesystem: then it is sent again
            continue
        sync_folder(path.parent)
        return True
    return False
