"""Joined uploads: a client sends parts of a file in parallel, and the platform concatenates them.

**Conventions.** A part is an upload of the purpose `part`; once used, its target is the whole. The whole is open, with
the ids of its parts in `detail`, until they are joined. In the store, rows move in the transaction that creates the
whole. In a folder, each part is appended, flushed and deleted in turn. The folder therefore stores little more than the
file, and a killed process continues at the end of the file.
"""

from collections.abc import Sequence
from hashlib import sha256

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access.storage_quota import release, reserve
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads import part_rows
from services.runtime.uploads.backends import FolderUploadBackend, LockedUpload
from services.runtime.uploads.creation import (
    UploadDeclaration,
    new_upload,
    owner_limit_bytes,
    refuse_foreign_target,
    refuse_too_many,
)
from services.runtime.uploads.errors import upload_state, upload_too_large
from services.runtime.uploads.files import make_file, upload_file
from services.runtime.uploads.part_rows import STORE
from services.runtime.uploads.rows import PART, UploadOwner, move
from stone.errors import Refused

MOST_PARTS = 15
"""The number of ids that fit into `detail`."""
COPIED_BYTES = 8 << 20


def create_joined(
    platform: Platform, owner: UploadOwner, declared: UploadDeclaration, part_ids: Sequence[str]
) -> Upload:
    """Create an upload from the owner's complete parts, in this order; its length is the sum of theirs.

    Raises `bad_parts`, `upload_missing`, `wrong_upload_state`, and the errors of `create`.
    """
    if not 1 <= len(part_ids) <= MOST_PARTS or len(set(part_ids)) < len(part_ids):
        raise _bad_parts(f"the request names {len(part_ids)} parts, {len(set(part_ids))} of them different")
    refuse_foreign_target(platform, owner, declared)
    with platform.database.transaction() as session:
        parts = [_lock_part(session, part_id, owner) for part_id in sorted(part_ids)]
        parts.sort(key=lambda part: part_ids.index(part.id))
        length_bytes, limit_bytes = sum(part.length_bytes for part in parts), platform.settings.uploads.max_bytes
        if length_bytes > limit_bytes:
            raise upload_too_large(length_bytes, limit_bytes)
        if len({part.backend for part in parts}) > 1:
            raise _bad_parts("the upload backend changed between these parts; upload them again")
        whole = new_upload(platform, owner, declared, length_bytes)
        whole.backend, whole.detail = parts[0].backend, " ".join(part.id for part in parts)
        for part in parts:
            move(session, part, "consumed", target_id=whole.id)
            release(session, part.id, "joined")
        reserve(session, owner.user_id, length_bytes, whole.id, "upload", owner_limit_bytes(platform, owner))
        refuse_too_many(session, platform.settings, owner)
        session.add(whole)
        session.flush()
        if whole.backend == STORE:
            part_rows.join(session, whole.id, [(part.id, part.length_bytes) for part in parts])
        else:
            make_file(upload_file(platform.settings, whole.id))
    return whole


def part_ids_of(upload: Upload) -> list[str]:
    """Return the parts of an open joined upload; [] for any other upload."""
    return upload.detail.split() if upload.state == "open" else []


def join_parts(platform: Platform, whole: Upload, held: LockedUpload) -> str:
    """Append the missing parts and delete them; return the hash of all bytes if this call appended all of them, or "".

    Raises `FileNotFoundError`, `DiskFullError`.
    """
    backend = FolderUploadBackend(platform)
    state, start = sha256(), 0
    is_seen = held.kept_bytes == 0
    for part in _find_parts(platform, whole):
        stop = start + part.length_bytes
        if held.kept_bytes < stop:
            with backend.local(part) as path, path.open("rb", buffering=0) as file:
                file.seek(held.kept_bytes - start)
                while piece := file.read(COPIED_BYTES):
                    held.append([piece], held.kept_bytes)
                    state.update(piece)
            held.accept(is_whole=True)
        backend.remove(part.id)
        start = stop
    return state.hexdigest() if is_seen else ""


def _find_parts(platform: Platform, whole: Upload) -> list[Upload]:
    with platform.database.reading() as session:
        return [session.get_one(Upload, part_id) for part_id in part_ids_of(whole)]


def _lock_part(session: Session, part_id: str, owner: UploadOwner) -> Upload:
    """Return a complete part of the owner's, locked."""
    held = select(Upload).where(Upload.id == part_id, Upload.owner_id == owner.user_id).with_for_update()
    part = session.scalar(held)
    if part is None:
        raise Refused("upload_missing", f"you have no upload {part_id[:64]!r}")
    if part.purpose != PART:
        raise _bad_parts(f"{part_id} was not created with Upload-Concat: partial")
    if part.state != "complete":
        raise upload_state(part_id, part.state, "joined", "complete")
    return part


def _bad_parts(why: str) -> Refused:
    return Refused(
        "bad_parts", f"{why}; name 1 to {MOST_PARTS} complete uploads (Upload-Concat: partial), each once, in order"
    )
