"""Small files uploaded as multipart forms (`curl -F`), spooled to disk.

**Conventions.** The parts may come in any order. The file is spooled to a temporary file by Starlette's parser, whose
bounds are ours: one file, four fields of at most 1 KiB. The body's bound is the middleware's
(`api/middleware/bodies.py`), which counts what comes.
"""

from tempfile import SpooledTemporaryFile
from typing import IO

from fastapi import Request
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from api.deps import Caller
from api.tus.body_stream import BLOCK_BYTES, in_thread
from api.tus.creation import owner_of, refuse_unscoped
from api.tus.errors import FormError, UnsupportedMediaTypeError
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.completion import end
from services.runtime.uploads.creation import UploadDeclaration, create
from services.runtime.uploads.errors import UploadTooLargeError
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.rows import UploadOwner

FIELDS = ("purpose", "target_id", "sha256")
LONGEST_FIELD_BYTES = 1024
FORM_TYPE = "multipart/form-data"


async def accept_form(request: Request, platform: Platform, caller: Caller) -> Upload:
    """The complete upload that the form holds.

    Raises `UnsupportedMediaTypeError`, `FormError`, `UploadTooLargeError` and what creating and receiving raise.
    """
    form = await _parse(request)
    try:
        files = [part for part in form.getlist("file") if isinstance(part, UploadFile)]
        fields = {name: value for name in form if isinstance(value := form[name], str)}
        if len(files) != 1 or set(fields) - set(FIELDS):
            raise FormError(f"one file named 'file' and the fields {', '.join(FIELDS)} are expected")
        declared = _declared(files[0], fields)
        if declared.length_bytes > platform.settings.uploads.form_bytes:
            raise UploadTooLargeError(declared.length_bytes, platform.settings.uploads.form_bytes)
        refuse_unscoped(caller, declared)
        return await in_thread(_keep, platform, owner_of(caller), declared, files[0].file)
    finally:
        await form.close()


async def _parse(request: Request) -> FormData:
    given = request.headers.get("content-type", "")
    if given.partition(";")[0].strip().lower() != FORM_TYPE:
        raise UnsupportedMediaTypeError(given, FORM_TYPE)
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
        raise FormError(str(error)[:120]) from error


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
