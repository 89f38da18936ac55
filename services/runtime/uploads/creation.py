"""Creates uploads: space for the bytes first, then the row and its quota.

**Conventions.** Bytes without a row are swept (`expiry`), a row whose backend knows nothing of it is never made. A file
the owner has already is not sent again: the new upload is given the same bytes and is complete at once. What others
have is never looked at, so nothing can be learnt about it.
"""

from services.runtime.access.storage_quota import reserve
from services.runtime.orm import Upload, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.declaration import UploadDeclaration
from services.runtime.uploads.errors import UploadTooLargeError
from services.runtime.uploads.rows import UploadOwner, expiry_ns
from services.runtime.uploads.targets import refuse_foreign_target
from services.runtime.uploads.waiting import hold_draft, refuse_too_many


def create(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> Upload:
    """A new upload, open, or complete when the owner has these bytes already.

    Raises `UploadTooLargeError`, `UploadTargetMissingError`, `UndeclaredUploadError`, `TooManyUploadsOfDraftError`,
    `QuotaExceededError`, `TooManyUploadsError`, `DiskFullError`.
    """
    limit_bytes = platform.settings.uploads.max_bytes
    if declared.length_bytes > limit_bytes:
        raise UploadTooLargeError(declared.length_bytes, limit_bytes)
    refuse_foreign_target(platform, owner, declared)
    upload = _row(platform, owner, declared)
    backend = backend_of(platform, upload)
    is_here = backend.begin(upload)
    try:
        with platform.database.transaction() as session:
            hold_draft(session, platform.settings, declared)
            limit_bytes = owner_limit_bytes(platform, owner)
            reserve(session, owner.user_id, upload.length_bytes, upload.id, "upload", limit_bytes)  # locks the owner
            refuse_too_many(session, platform.settings, owner)
            session.add(upload)
            session.flush()
            if is_here or backend.enter(session, upload):
                upload.state, upload.sha256 = "complete", declared.sha256
    except BaseException:
        backend.remove(upload.id)
        raise
    return upload


def owner_limit_bytes(platform: Platform, owner: UploadOwner) -> int:
    """The most bytes the owner may have stored or under way."""
    settings = platform.settings
    return settings.submissions.participant_bytes if owner.is_participant else settings.uploads.owner_bytes


def _row(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> Upload:
    return Upload(
        id=new_id(),
        owner_id=owner.user_id,
        purpose=declared.purpose,
        target_id=declared.target_id,
        backend=platform.settings.uploads.backend,
        filename=declared.filename,
        length_bytes=declared.length_bytes,
        declared_sha256=declared.sha256,
        state="open",
        sha256="",
        detail="",
        created_ns=now_ns(),
        expires_ns=expiry_ns(platform),
    )
