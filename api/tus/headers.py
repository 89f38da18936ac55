"""Strict parsers of the tus 1.0 headers: numbers, checksums, metadata.

**Conventions.** Protocol: tus.io, resumable upload 1.0.0 with creation, creation-with-upload, checksum, concatenation,
expiration and termination. Metadata keys: `filename` and `purpose`, and where known `target_id` and `sha256`; others
are read and ignored, since clients add their own.
"""

import re
from base64 import b64decode
from binascii import Error as Base64Error
from email.utils import formatdate
from typing import Annotated, Any

from fastapi import Header, Request
from fastapi.routing import APIRoute
from starlette.datastructures import MutableHeaders
from starlette.types import Message, Receive, Scope, Send

from api.answers import Responses, refusals
from api.errors import ApiError
from api.tus.errors import VERSION, unsupported_media_type
from services.runtime.orm import Upload
from services.runtime.uploads.creation import PURPOSES, UploadDeclaration
from services.runtime.uploads.errors import BadMetadataError
from services.runtime.uploads.reception import ALGORITHMS, Checksum, UploadChunk
from services.runtime.uploads.rows import PART

EXTENSIONS = "creation,creation-with-upload,checksum,concatenation,expiration,termination"
CHUNK_TYPE = "application/offset+octet-stream"
LONGEST_METADATA = 8192
MOST_PAIRS = 32
COUNT = re.compile(r"[0-9]{1,18}")
KEY = re.compile(r"[A-Za-z0-9_.-]{1,64}")


async def speak_tus(
    tus_resumable: Annotated[str, Header(description=f"Version of tus: `{VERSION}`.", examples=[VERSION])] = "",
) -> None:
    """Require the supported tus version, as a dependency. Raises `tus_version`."""
    if tus_resumable != VERSION:
        raise ApiError(
            "tus_version",
            f"Tus-Resumable is {tus_resumable[:40]!r}; this server supports {VERSION} only",
            {"Tus-Version": VERSION},
        )


def count_of(request: Request, name: str) -> int:
    """Return the header as a number of bytes. Raises `bad_tus_header`."""
    given = request.headers.get(name, "")
    if not COUNT.fullmatch(given):
        raise ApiError("bad_tus_header", f"{name} is {given[:80]!r}; expected a count of bytes, digits only")
    return int(given)


def piece_of(request: Request, offset_bytes: int) -> UploadChunk:
    """Return the request's headers about its body. Raises `bad_tus_header`, `unsupported_media_type`."""
    given = request.headers.get("content-type", "")
    if given != CHUNK_TYPE:
        raise unsupported_media_type(given, CHUNK_TYPE)
    is_sized = "content-length" in request.headers
    return UploadChunk(offset_bytes, count_of(request, "Content-Length") if is_sized else None, _checksum(request))


def declared_by(request: Request, length_bytes: int, *, is_part: bool = False) -> UploadDeclaration:
    """Return the file that a creation declares, or a part of a file, which needs no metadata.

    Raises `bad_tus_header`, `BadMetadataError`.
    """
    known = _metadata(request.headers.get("upload-metadata", ""))
    if is_part:
        known = {"filename": PART, **known, "purpose": PART, "target_id": ""}
    for name in ("filename", "purpose"):
        if name not in known:
            raise BadMetadataError(name, "", "a pair of Upload-Metadata")
    return UploadDeclaration(
        known["filename"],
        known["purpose"],
        length_bytes,
        known.get("target_id", ""),
        known.get("sha256", "").lower(),
    )


def upload_headers(upload: Upload, offset_bytes: int) -> dict[str, str]:
    """Return the response headers about an upload: its offset, and its expiry."""
    headers = {"Upload-Offset": str(offset_bytes), "Upload-Length": str(upload.length_bytes)}
    if upload.state in ("open", "complete"):
        headers["Upload-Expires"] = formatdate(upload.expires_ns / 1e9, usegmt=True)
    return headers


def _checksum(request: Request) -> Checksum | None:
    given = request.headers.get("upload-checksum")
    if given is None:
        return None
    algorithm, _, encoded = given.partition(" ")
    expected = f"one of {', '.join(ALGORITHMS)}, a space, and the digest in base64"
    if algorithm not in ALGORITHMS:
        raise ApiError("bad_tus_header", f"Upload-Checksum is {given[:80]!r}; expected {expected}")
    digest = _decoded("Upload-Checksum", encoded)
    if len(digest) != {"sha1": 20, "sha256": 32}[algorithm]:
        raise ApiError("bad_tus_header", f"Upload-Checksum is {given[:80]!r}; expected {expected}")
    return Checksum(algorithm, digest)


def _metadata(header: str) -> dict[str, str]:
    """Return the comma-separated pairs of a key and a base64 value. Raises `bad_tus_header`, `BadMetadataError`."""
    if len(header) > LONGEST_METADATA:
        raise ApiError(
            "bad_tus_header", f"Upload-Metadata is {header[:80]!r}; expected at most {LONGEST_METADATA} characters"
        )
    pairs = [pair.strip() for pair in header.split(",")] if header else []
    if len(pairs) > MOST_PAIRS:
        raise ApiError("bad_tus_header", f"Upload-Metadata is {header[:80]!r}; expected at most {MOST_PAIRS} pairs")
    known: dict[str, str] = {}
    for pair in pairs:
        key, _, encoded = pair.partition(" ")
        if not KEY.fullmatch(key) or key in known:
            raise ApiError(
                "bad_tus_header",
                f"Upload-Metadata is {pair[:80]!r}; expected keys of letters, digits, '_', '.' and '-', each once",
            )
        known[key] = _text(key, _decoded("Upload-Metadata", encoded))
    return known


def _decoded(header: str, encoded: str) -> bytes:
    try:
        return b64decode(encoded.encode("ascii"), validate=True)
    except (Base64Error, UnicodeEncodeError) as error:
        raise ApiError("bad_tus_header", f"{header} is {encoded[:80]!r}; expected base64") from error


def _text(key: str, value: bytes) -> str:
    try:
        return value.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadMetadataError(key, value.hex(), "UTF-8") from error


class TusRoute(APIRoute):
    """`APIRouter(route_class=TusRoute)`."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def say(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Tus-Resumable"] = VERSION
                if scope["method"] == "HEAD":  # an offset is true for a moment only
                    headers["Cache-Control"] = "no-store"
            await send(message)

        await super().handle(scope, receive, say)


def _headers(**described: str) -> dict[str, Any]:
    text = {"type": "string"}
    return {name.replace("_", "-"): {"description": words, "schema": text} for name, words in described.items()}


_PROGRESS = _headers(
    Tus_Resumable="1.0.0",
    Upload_Offset="Number of bytes received",
    Upload_Expires="Expiry (RFC 9110 date)",
)

STREAM: dict[str, Any] = {
    "requestBody": {
        "required": False,
        "content": {"application/offset+octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
FORM: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file", "purpose"],
                    "properties": {
                        "file": {"type": "string", "format": "binary"},
                        "purpose": {"type": "string", "enum": list(PURPOSES)},
                        "target_id": {"type": "string"},
                        "sha256": {"type": "string"},
                    },
                }
            }
        },
    }
}
OPTIONS_SAY: Responses = {204: {"description": "Supported tus version", "headers": _headers(Tus_Version="1.0.0")}}
CREATED: Responses = {
    201: {"description": "Created", "headers": {**_headers(Location="URL of the upload"), **_PROGRESS}},
    **refusals(400, 404, 408, 409, 412, 413, 415, 423, 460, 507),
}
HEAD_SAYS: Responses = {
    200: {"description": "Offset to resume from", "headers": _PROGRESS},
    **refusals(404, 409, 410, 412, 460, 507),
}
PATCHED: Responses = {
    204: {"description": "Appended", "headers": _PROGRESS},
    **refusals(400, 404, 408, 409, 410, 412, 413, 415, 423, 460, 507),
}
TERMINATED: Responses = {204: {"description": "Terminated"}, **refusals(404, 409, 410, 412, 423)}
GOT: Responses = refusals(404)
FORMED: Responses = {
    201: {"description": "Complete", "headers": _headers(Location="URL of the upload")},
    **refusals(400, 404, 408, 409, 413, 415, 460, 507),
}
