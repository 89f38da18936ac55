"""All bytes are there: the file is what it was declared to be and complete, or it is not and goes.

**Conventions.** Whoever settles holds the file's lock, so it happens once. A process that dies before the row has
changed leaves an open upload with all its bytes; the next look at it, or the sweeper, settles it.
"""

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.creating import expiry_ns
from services.runtime.uploads.errors import FileMismatchError, UploadLockedError, UploadStateError
from services.runtime.uploads.files import HeldFile, offset_of, remove_file, upload_file
from services.runtime.uploads.hashing import sha256_of
from services.runtime.uploads.rows import WHOLE, find, leave, move


def settle(platform: Platform, upload: Upload, file: HeldFile, sha256: str = "") -> Upload:
    """Complete an open upload whose bytes are all on disk; `sha256` as seen while they came, else it is read again.

    Raises `FileMismatchError` when it is not the declared file, which is removed then.
    """
    found = sha256 or sha256_of(file.descriptor)
    if upload.declared_sha256 not in ("", found):
        mismatch = FileMismatchError(upload.id, found, upload.declared_sha256)
        end(platform, upload, "failed", str(mismatch))
        raise mismatch
    with platform.database.transaction() as session:
        if not move(session, upload, "complete", sha256=found, expires_ns=expiry_ns(platform)):
            raise UploadStateError(upload.id, "no longer open", "completed", "open")
    return find(platform.database, upload.id, upload.owner_id)


def end(platform: Platform, upload: Upload, state: str, detail: str = "") -> bool:
    """Leave for a state without a file: row and quota first, then the file; false when somebody else was first."""
    with platform.database.transaction() as session:
        moved = leave(session, upload, state, detail)
    if moved:
        remove_file(upload_file(platform.settings, upload.id))
    return moved


def terminate(platform: Platform, upload: Upload) -> None:
    """Give an upload up. Raises `UploadStateError` when it is in use, `UploadLockedError` while bytes come in."""
    held = HeldFile(upload_file(platform.settings, upload.id)) if upload.state == "open" else None
    try:
        current = find(platform.database, upload.id, upload.owner_id)
        if current.state not in ("open", "complete") or not end(platform, current, "terminated"):
            raise UploadStateError(upload.id, current.state, "terminated", "open or complete")
    finally:
        if held is not None:
            held.close()


def settle_if_whole(platform: Platform, upload: Upload) -> Upload:
    """The upload, settled first when its bytes are all there and nobody is at it.

    Raises `FileMismatchError`, `FileNotFoundError`.
    """
    path = upload_file(platform.settings, upload.id)
    if upload.state != "open" or offset_of(path) < upload.length_bytes:
        return upload
    try:
        held = HeldFile(path)
    except UploadLockedError:
        return upload
    try:
        current = find(platform.database, upload.id, upload.owner_id)
        is_whole = current.state == "open" and held.size_bytes == current.length_bytes
        return settle(platform, current, held) if is_whole else current
    finally:
        held.close()


def bytes_here(platform: Platform, upload: Upload) -> int:
    """The offset to show: bytes on disk while it is open, all of them once it is whole, 0 when it is gone."""
    if upload.state != "open":
        return upload.length_bytes if upload.state in WHOLE else 0
    try:
        return offset_of(upload_file(platform.settings, upload.id))
    except FileNotFoundError:
        return 0
