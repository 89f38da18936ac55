"""Responses from stored files: whole, one byte range, or 304 Not Modified.

**Conventions.** The ETag is the sha256 of the whole representation, so it never lies; `Repr-Digest` (RFC 9530) says it
too, and `Content-Digest` where the whole is sent. One range is served (206), one
beyond the end is refused (416), several or malformed ones are answered with the whole, as RFC 9110 §14.2 allows. Bytes
go from the store to the socket in pieces; the first is read before the status is sent, so a missing object is an error
and not half an answer. A whole file is hashed while it is sent: if its bytes differ, the last piece is held back and
the connection is closed, so that no client accepts the file. A single range cannot be compared. Browsers never render
an uploaded file: `attachment`, `nosniff`, `sandbox`.
"""

import re
from base64 import b64encode
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import sha256
from itertools import chain
from urllib.parse import quote

from fastapi import Request, Response
from fastapi.responses import StreamingResponse

from api.answers import Responses, refusals
from api.deps import platform_of
from api.errors import ApiError
from api.etags import etag, is_unchanged
from services.runtime.database.transactions import Database
from services.runtime.store.faults import ObjectDamagedError, note_served
from services.runtime.store.protocol import Store
from stone_base.label_grid import PAPER, LabelGrid

HASHERS = ThreadPoolExecutor(4, "hash")
"""Threads that hash pieces while they are sent."""
ONE_RANGE = re.compile(r"bytes=(\d{0,18})-(\d{0,18})")
UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
STRUCTURED = ("application/json", "application/yaml")
OBJECT = {"type": "object"}
BINARY = {"type": "string", "format": "binary"}
INLINE = ("image/png", "image/jpeg", "application/json", "text/html")
# Whoever signs out, or in as somebody else, asks again: `Vary` names what a caller is known by.
LASTING = "private, max-age=31536000, immutable"
LOCKED = "default-src 'none'; sandbox"
# Pages are ours (`quality.html`); they bring their style and pictures with them, and run and load nothing.
POLICIES = {"text/html": "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"}


@dataclass(frozen=True)
class StoredFile:
    """The bytes [offset, offset + size) of an object, and how they are called outside; of labels their grid."""

    object_key: str
    size_bytes: int
    sha256: str
    media_type: str
    filename: str
    offset_bytes: int = 0
    is_lasting: bool = False
    grid: LabelGrid = PAPER


@dataclass(frozen=True)
class ServedFile:
    """Bytes to answer with, of which `read(start, stop)` gives any range in pieces, and how they are called outside.

    `object_keys` are the objects that hold the bytes, none if the request generated them. If `is_lasting`, the bytes
    at this address never change, so a browser requests them once.
    """

    size_bytes: int
    sha256: str
    media_type: str
    filename: str
    read: Callable[[int, int], Iterator[bytes]]
    object_keys: tuple[str, ...]
    is_lasting: bool = False


@dataclass(frozen=True)
class GeneratedFile:
    """A file that no store holds: its name and media type for downloads."""

    media_type: str
    filename: str
    is_lasting: bool = False


def file_responses(*media_types: str) -> Responses:
    """The OpenAPI responses of a route that answers with a file."""
    content = {media_type: {"schema": OBJECT if media_type in STRUCTURED else BINARY} for media_type in media_types}
    whole = {"description": "The whole file", "content": content}
    part = {"description": "The requested range", "content": content}
    return {200: whole, 206: part, 304: {"description": "The caller's copy is current"}, **refusals(404, 416)}


def answer_file(request: Request, store: Store, file: StoredFile) -> Response:
    """The file as 200, 206 or 304. Raises `range_not_satisfiable` (416), `ObjectMissingError`."""
    begin = file.offset_bytes

    def read(start: int, stop: int) -> Iterator[bytes]:
        return store.read(file.object_key, begin + start, begin + stop)

    facts = (file.size_bytes, file.sha256, file.media_type, file.filename)
    return answer_bytes(request, ServedFile(*facts, read, (file.object_key,), file.is_lasting))


def read_whole(store: Store, file: StoredFile) -> bytes:
    """Return all bytes of a small file. Raises `ObjectDamagedError`, `ObjectMissingError`."""
    begin = file.offset_bytes
    content = b"".join(store.read(file.object_key, begin, begin + file.size_bytes))
    if sha256(content).hexdigest() != file.sha256:
        raise ObjectDamagedError(file.filename, (file.object_key,))
    return content


def answer_made(request: Request, content: bytes, facts: GeneratedFile) -> Response:
    """Bytes that were made just now, as `answer_bytes` answers. Raises `range_not_satisfiable` (416)."""
    digest = sha256(content).hexdigest()

    def read(start: int, stop: int) -> Iterator[bytes]:
        yield content[start:stop]

    return answer_bytes(
        request, ServedFile(len(content), digest, facts.media_type, facts.filename, read, (), facts.is_lasting)
    )


def answer_bytes(request: Request, file: ServedFile) -> Response:
    """The bytes as 200, 206 or 304; to HEAD the head. Raises `range_not_satisfiable` (416), what reading raises."""
    headers = _headers(file)
    if is_unchanged(request, file.sha256):
        return Response(status_code=304, headers={key: headers[key] for key in ("ETag", "Cache-Control", "Vary")})
    if request.method == "HEAD":  # to which no range applies (RFC 9110 §14.2)
        return Response(headers={**headers, "Content-Length": str(file.size_bytes)}, media_type=file.media_type)
    start, stop = 0, file.size_bytes
    asked = _range(request, file)
    if asked is None:
        headers["Content-Digest"] = headers["Repr-Digest"]
    else:
        start, stop = asked
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{file.size_bytes}"
    headers["Content-Length"] = str(stop - start)
    status = 200 if asked is None else 206
    pieces = file.read(start, stop)
    if file.object_keys and stop - start == file.size_bytes:
        pieces = _compared(pieces, file, platform_of(request).database)
    return StreamingResponse(_opened(pieces), status, headers, media_type=file.media_type)


def safe_name(name: str) -> str:
    """The name without anything that a header or a file system could take for more than a name."""
    return UNSAFE.sub("_", name).strip("._")[:150] or "file"


def _headers(file: ServedFile) -> dict[str, str]:
    shown = "inline" if file.media_type in INLINE else "attachment"
    spelled = quote(file.filename[:150], safe="")
    return {
        "ETag": etag(file.sha256),
        "Repr-Digest": f"sha-256=:{b64encode(bytes.fromhex(file.sha256)).decode()}:",
        "Accept-Ranges": "bytes",
        "Cache-Control": LASTING if file.is_lasting else "private, no-cache",
        "Vary": "Authorization, Cookie",
        "Content-Disposition": f"{shown}; filename=\"{safe_name(file.filename)}\"; filename*=UTF-8''{spelled}",
        "X-Content-Type-Options": "nosniff",
        "Content-Security-Policy": POLICIES.get(file.media_type, LOCKED),
    }


def _range(request: Request, file: ServedFile) -> tuple[int, int] | None:
    """The half-open range asked for; None: the whole. Raises `range_not_satisfiable`."""
    found = ONE_RANGE.fullmatch(request.headers.get("range", "").strip())
    if found is None or found.group() == "bytes=-" or not _is_same(request, file):
        return None
    first, last = found.groups()
    if not first:
        start, stop = max(file.size_bytes - int(last), 0), file.size_bytes
    else:
        start, stop = int(first), min(int(last) + 1, file.size_bytes) if last else file.size_bytes
        if last and int(last) < start:
            return None
    if start >= file.size_bytes:
        raise ApiError(
            "range_not_satisfiable",
            f"the file has {file.size_bytes} bytes; the range starts after its end",
            {"Content-Range": f"bytes */{file.size_bytes}", "Accept-Ranges": "bytes"},
        )
    return start, stop


def _is_same(request: Request, file: ServedFile) -> bool:
    """Whether the range is of the file the caller has in mind, if it says which (RFC 9110 §13.1.5: strongly)."""
    return request.headers.get("if-range", etag(file.sha256)) == etag(file.sha256)


def _compared(pieces: Iterator[bytes], file: ServedFile, database: Database) -> Iterator[bytes]:
    """Yield the pieces of the whole file, each hashed while it is sent; the last only if the hash is right.

    Raises `ObjectDamagedError`.
    """
    digest, hashed, held = sha256(), None, next(pieces, b"")
    for piece in pieces:
        if hashed is not None:
            hashed.result()
        hashed = HASHERS.submit(digest.update, held)
        yield held
        held = piece
    if hashed is not None:
        hashed.result()
    digest.update(held)
    if digest.hexdigest() != file.sha256:
        if hashed is not None:  # too late for a refusal, whose handler records the fault
            note_served(database, file.object_keys)
        raise ObjectDamagedError(file.filename, file.object_keys)
    yield held


def _opened(pieces: Iterator[bytes]) -> Iterator[bytes]:
    first = next(pieces, b"")
    return chain((first,), pieces)
