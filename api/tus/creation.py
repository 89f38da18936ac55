"""Creation of uploads: by tus, with or without first bytes, or whole by a form.

**Conventions.** If the bytes of a creation are refused, the upload is deleted, because its client never received the
upload's name. Only a full disk leaves it open, and keeps the bytes that fitted.
"""

from tempfile import SpooledTemporaryFile
from typing import IO

from fastapi import Request
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from api.deps import Caller
from api.errors import ApiError, ForbiddenError
from api.tus.body_stream import BLOCK_BYTES, in_thread, receive_body
from api.tus.errors import unsupported_media_type
from api.tus.headers import count_of, declared_by, piece_of
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.completion import end, settle_if_whole
from services.runtime.uploads.creation import SUBMISSION, UploadDeclaration, create
from services.runtime.uploads.errors import DiskFullError, upload_too_large
from services.runtime.uploads.joining import create_joined
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.rows import UploadOwner, find, find_alive
from stone.errors import StoneError


async def accept_creation(request: Request, platform: Platform, caller: Caller) -> Upload:
    """Create the upload that the request's headers declare, with the bytes of its body."""
    if "upload-defer-length" in request.headers:
        raise ApiError("length_deferred", "Upload-Defer-Length is not supported; send Upload-Length with the creation")
    kind, _, named = request.headers.get("upload-concat", "").partition(";")
    if kind == "final":
        return await _joined(request, platform, caller, named)
    if kind not in ("", "partial"):
        raise ApiError("bad_tus_header", f"Upload-Concat is {kind[:80]!r}; expected partial, or final;URL URL …")
    declared = declared_by(request, count_of(request, "Upload-Length"), is_part=kind == "partial")
    first = piece_of(request, 0) if _brings_bytes(request) else None
    refuse_unscoped(caller, declared)
    upload = await in_thread(create, platform, owner_of(caller), declared)
    if upload.state == "complete":
        return upload
    if first is None:
        return await in_thread(settle_if_whole, platform, upload)  # an empty file
    return await _receive_first(request, platform, upload, first)


def owner_of(caller: Caller) -> UploadOwner:
    """Return the caller as the owner of an upload."""
    return UploadOwner(caller.user_id, caller.is_administrator, caller.role == "participant")


def find_own(platform: Platform, upload_id: str, caller: Caller) -> Upload:
    """Return the caller's upload, if it is alive. Raises `upload_missing`, `upload_gone`, `ForbiddenError`."""
    upload = find_alive(platform.database, upload_id, caller.user_id)
    if upload.purpose != SUBMISSION and "upload" not in caller.scopes:
        raise ForbiddenError(f"a {upload.purpose} requires the scope 'upload'; yours are {sorted(caller.scopes)}")
    return upload


def refuse_unscoped(caller: Caller, declared: UploadDeclaration) -> None:
    """Require the scope `submit` for a submission, `upload` for other uploads. Raises `ForbiddenError`."""
    scope = "submit" if declared.purpose == SUBMISSION else "upload"
    if scope not in caller.scopes:
        raise ForbiddenError(f"a {declared.purpose} requires the scope {scope!r}; yours are {sorted(caller.scopes)}")


async def _joined(request: Request, platform: Platform, caller: Caller, named: str) -> Upload:
    """Create the upload that joins the parts with these URLs."""
    declared = declared_by(request, 0)
    refuse_unscoped(caller, declared)
    part_ids = [url.rpartition("/")[2] for url in named.split()]
    upload = await in_thread(create_joined, platform, owner_of(caller), declared, part_ids)
    return await in_thread(settle_if_whole, platform, upload)


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


# Small files uploaded as multipart forms (`curl -F`), spooled to disk.
#
# **Conventions.** The parts may come in any order. The file is spooled to a temporary file by Starlette's parser,
# whose bounds are ours: one file, four fields of at most 1 KiB. The body's bound is the middleware's
# (`api/middleware/bodies.py`), which counts what comes.


FIELDS = ("purpose", "target_id", "sha256")
LONGEST_FIELD_BYTES = 1024
FORM_TYPE = "multipart/form-data"


async def accept_form(request: Request, platform: Platform, caller: Caller) -> Upload:
    """Create the complete upload that the form contains.

    Raises `unsupported_media_type`, `bad_form`, `upload_too_large` and the errors of creating and receiving.
    """
    form = await _parse(request)
    try:
        files = [part for part in form.getlist("file") if isinstance(part, UploadFile)]
        fields = {name: value for name in form if isinstance(value := form[name], str)}
        if len(files) != 1 or set(fields) - set(FIELDS):
            raise bad_form(f"expected one file named 'file' and the fields {', '.join(FIELDS)}")
        declared = _declared(files[0], fields)
        if declared.length_bytes > platform.settings.uploads.form_bytes:
            raise upload_too_large(declared.length_bytes, platform.settings.uploads.form_bytes)
        refuse_unscoped(caller, declared)
        return await in_thread(_keep, platform, owner_of(caller), declared, files[0].file)
    finally:
        await form.close()


async def _parse(request: Request) -> FormData:
    given = request.headers.get("content-type", "")
    if given.partition(";")[0].strip().lower() != FORM_TYPE:
        raise unsupported_media_type(given, FORM_TYPE)
    parser = MultiPartParser(
        request.headers,
        request.stream(),
        max_files=1,
        max_fields=len(FIELDS),
        max_part_size=LONGEST_FIELD_BYTES,
    )
    try:
        return await parser.parse()
    except (MultiPartException, UnicodeDecodeError, KeyError, ValueError) as error:
        raise bad_form(str(error)[:120]) from error


def _declared(file: UploadFile, fields: dict[str, str]) -> UploadDeclaration:
    return UploadDeclaration(
        file.filename or "",
        fields.get("purpose", ""),
        file.size or 0,
        fields.get("target_id", ""),
        fields.get("sha256", "").lower(),
    )


def _keep(
    platform: Platform,
    owner: UploadOwner,
    declared: UploadDeclaration,
    source: "IO[bytes] | SpooledTemporaryFile[bytes]",
) -> Upload:
    """Move the spooled bytes into an upload; one that cannot be completed leaves nothing behind."""
    upload = create(platform, owner, declared)
    if upload.state == "complete":
        return upload
    reception = receive(platform, upload.id, upload.owner_id, UploadChunk(0, declared.length_bytes))
    if reception is None:
        return upload
    try:
        source.seek(0)
        while block := source.read(BLOCK_BYTES):
            reception.write([block])
        return reception.end()
    except BaseException:
        end(platform, upload, "terminated", "the form's file could not be kept")
        raise
    finally:
        reception.close()


def bad_form(why: str) -> ApiError:
    return ApiError("bad_form", f"invalid form: {why} (curl -F file=@NAME -F purpose=recording -F target_id=ID)")
