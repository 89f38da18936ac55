"""Creation of uploads: by tus, with or without first bytes, or whole by a form.

**Conventions.** A creation whose bytes are refused leaves nothing behind, for its client was never told the upload's
name; only a full disk leaves it open, for what fitted counts.
"""

from fastapi import Request

from api.deps import Caller
from api.errors import ForbiddenError
from api.tus.body_stream import in_thread, receive_body
from api.tus.errors import ExtensionError, LengthDeferredError
from api.tus.headers import count_of, declared_by, piece_of
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.completion import end, settle_if_whole
from services.runtime.uploads.creation import SUBMISSION, UploadDeclaration, create
from services.runtime.uploads.errors import DiskFullError
from services.runtime.uploads.reception import UploadChunk
from services.runtime.uploads.rows import UploadOwner, find, find_alive
from stone.errors import StoneError


async def accept_creation(request: Request, platform: Platform, caller: Caller) -> Upload:
    """The upload that the request's headers declare, with what its body holds."""
    if "upload-defer-length" in request.headers:
        raise LengthDeferredError()
    if "upload-concat" in request.headers:
        raise ExtensionError("Upload-Concat")
    declared = declared_by(request, count_of(request, "Upload-Length"))
    first = piece_of(request, 0) if _brings_bytes(request) else None
    refuse_unscoped(caller, declared)
    upload = await in_thread(create, platform, owner_of(caller), declared)
    if upload.state == "complete":
        return upload
    if first is None:
        return await in_thread(settle_if_whole, platform, upload)  # a file of no bytes
    return await _receive_first(request, platform, upload, first)


def owner_of(caller: Caller) -> UploadOwner:
    """The caller as the owner of an upload."""
    return UploadOwner(caller.user_id, caller.is_administrator, caller.role == "participant")


def find_own(platform: Platform, upload_id: str, caller: Caller) -> Upload:
    """The caller's upload, alive. Raises `UploadMissingError`, `UploadGoneError`, `ForbiddenError`."""
    upload = find_alive(platform.database, upload_id, caller.user_id)
    if upload.purpose != SUBMISSION and "upload" not in caller.scopes:
        raise ForbiddenError(f"a {upload.purpose} needs the scope 'upload'; yours are {sorted(caller.scopes)}")
    return upload


def refuse_unscoped(caller: Caller, declared: UploadDeclaration) -> None:
    """A submission needs the scope `submit`, everything else `upload`. Raises `ForbiddenError`."""
    scope = "submit" if declared.purpose == SUBMISSION else "upload"
    if scope not in caller.scopes:
        raise ForbiddenError(f"a {declared.purpose} needs the scope {scope!r}; yours are {sorted(caller.scopes)}")


async def _receive_first(request: Request, platform: Platform, upload: Upload, first: UploadChunk) -> Upload:
    key = (upload.id, upload.owner_id)
    try:
        return (await receive_body(request, platform, key, first)).upload
    except DiskFullError:
        return await in_thread(find, platform.database, *key)
    except StoneError:
        await in_thread(end, platform, upload, "terminated", "its creation was refused")
        raise


def _brings_bytes(request: Request) -> bool:
    has_body = request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers
    return has_body or "content-type" in request.headers
