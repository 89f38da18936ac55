"""Finish uploads: verify the whole file, then complete or fail the upload.

**Conventions.** Only the holder of an upload's bytes settles it. If processes do not lock each other out, the row's
compare-and-set lets one of them succeed. If a process dies before it changes the row, the upload stays open with all
its bytes; the next request for it, or the sweeper, settles it.
"""

from contextlib import suppress

from sqlalchemy.exc import OperationalError

from services.runtime.database.ballast import is_full
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.backends import LockedUpload, backend_of
from services.runtime.uploads.errors import FileMismatchError, UploadLockedError, upload_state
from services.runtime.uploads.joining import join_parts, part_ids_of
from services.runtime.uploads.part_rows import STORE
from services.runtime.uploads.rows import WHOLE, expiry_ns, find, leave, move

ENDABLE = ("open", "complete")


def settle(platform: Platform, upload: Upload, held: LockedUpload, sha256: str = "") -> Upload:
    """Complete an open upload whose bytes are all kept; if `sha256` is empty, read the bytes again to compute it.

    Delete the file and raise `FileMismatchError` if it is not the declared file.
    """
    digest = sha256 or held.sha256()
    if upload.declared_sha256 not in ("", digest):
        mismatch = FileMismatchError(upload.id, digest, upload.declared_sha256)
        end(platform, upload, "failed", str(mismatch))
        raise mismatch
    with platform.database.transaction() as session:
        moved = move(session, upload, "complete", sha256=digest, detail="", expires_ns=expiry_ns(platform))
    current = find(platform.database, upload.id, upload.owner_id)
    if not moved and current.state not in WHOLE:  # another process may have settled it: then it is complete as well
        raise upload_state(upload.id, current.state, "completed", "open")
    return current


def end(platform: Platform, upload: Upload, state: str, detail: str = "") -> bool:
    """Move to a state without bytes: row and quota first, then the bytes. Return False if another process was first."""
    with platform.database.transaction() as session:
        moved = leave(session, upload, state, detail)
    if moved:
        backend_of(platform, upload).remove(upload.id)
    return moved


def terminate(platform: Platform, upload: Upload) -> None:
    """Terminate an upload. Raises `wrong_upload_state` if it is in use, `UploadLockedError` while bytes arrive.

    If its row cannot be written because the disk is full, its bytes are deleted first.
    """
    held = _hold_if_present(platform, upload) if upload.state == "open" else None
    try:
        current = find(platform.database, upload.id, upload.owner_id)
        if current.state not in ENDABLE:
            raise upload_state(upload.id, current.state, "terminated", "open or complete")
        try:
            is_ended = end(platform, current, "terminated")
        except OperationalError as error:
            if not is_full(error):
                raise
            backend_of(platform, current).remove(current.id)
            if held is not None:
                held.close()  # an open file keeps its blocks
            is_ended = end(platform, current, "terminated")
        if not is_ended:
            raise upload_state(upload.id, current.state, "terminated", "open or complete")
    finally:
        if held is not None:
            held.close()


def _hold_if_present(platform: Platform, upload: Upload) -> LockedUpload | None:
    """Return its bytes, locked; None if they were deleted before its row could be written."""
    with suppress(FileNotFoundError):
        return backend_of(platform, upload).hold(upload)
    return None


def settle_if_whole(platform: Platform, upload: Upload) -> Upload:
    """Return the upload; if all its bytes are present and no request holds them, settle it first.

    Raises `FileMismatchError`, `FileNotFoundError`.
    """
    backend, is_joined = backend_of(platform, upload), bool(part_ids_of(upload))
    if upload.state != "open" or (not is_joined and backend.offset_of(upload.id) < upload.length_bytes):
        return upload
    try:
        held = backend.hold(upload)
    except UploadLockedError:
        return upload
    try:
        current = find(platform.database, upload.id, upload.owner_id)
        seen = join_parts(platform, current, held) if is_joined and current.backend != STORE else ""
        is_whole = current.state == "open" and held.kept_bytes == current.length_bytes
        return settle(platform, current, held, seen) if is_whole else current
    finally:
        held.close()


def bytes_here(platform: Platform, upload: Upload) -> int:
    """Return the offset to show: counted bytes of an open upload, all bytes of a whole one, 0 of one that is gone."""
    if upload.state != "open":
        return upload.length_bytes if upload.state in WHOLE else 0
    try:
        return backend_of(platform, upload).offset_of(upload.id)
    except FileNotFoundError:
        return 0
