"""A tus 1.0 client: uploads a file with a checksum for every piece and the sha256 of the whole.

**Conventions.** The client stores nothing: it looks up the server's upload of the same bytes to the same target. So a
restarted client, or another one, continues from the last byte on the server's disk.
"""

import base64
import os
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from stone_client.api import Api, Patience
from stone_client.errors import ServerRefusedError, ServerUnreachableError, file_changed
from stone_client.progress import Report

TUS = {"Tus-Resumable": "1.0.0"}
PIECE_BYTES = 16 * 2**20
PATIENCE_S = 120.0
TRY_AGAIN = frozenset({408, 409, 423, 429, 460, 502, 503, 504})


@dataclass(frozen=True)
class Purpose:
    """The purpose of an upload, and the id of its target."""

    name: str
    target_id: str = ""


class LocalContent(Protocol):
    """Local bytes to upload: a file, or a folder as a tar."""

    @property
    def name(self) -> str: ...

    @property
    def size_bytes(self) -> int: ...

    @property
    def sha256(self) -> str: ...

    def read(self, offset: int, most_bytes: int) -> bytes:
        """Return up to `most_bytes` bytes from `offset`. Raises `file_changed`."""
        ...


@dataclass(frozen=True)
class LocalFile:
    """A file as it was when its sha256 was taken."""

    path: Path
    size_bytes: int
    modified_ns: int
    sha256: str

    @property
    def name(self) -> str:
        return self.path.name

    def read(self, offset: int, most_bytes: int) -> bytes:
        with self.path.open("rb") as file:
            refuse_change(self.path, file, (self.size_bytes, self.modified_ns))
            file.seek(offset)
            return file.read(most_bytes)


def refuse_change(path: Path, file: BinaryIO, before: tuple[int, int]) -> None:
    """Compare size and modification time (ns) with their earlier values. Raises `file_changed`."""
    now = os.fstat(file.fileno())
    if (now.st_size, now.st_mtime_ns) != before:
        raise file_changed(path)


def upload_file(api: Api, local: LocalContent, purpose: Purpose, progress: Report) -> str:
    """Send the bytes that the server does not have yet; return the id of the complete upload.

    Raises what `Api.send` raises, and `file_changed`.
    """
    upload_id, offset = begun(api, local, purpose) or created(api, local, purpose)
    send_rest(api, f"/uploads/{upload_id}", Rest(local, offset), progress)
    return upload_id


def hashed(path: Path, progress: Report) -> LocalFile:
    """Return the file with its sha256. Raises `file_changed`."""
    with path.open("rb") as file:
        now = os.fstat(file.fileno())
        whole, done = sha256(), 0
        progress("hash", done, now.st_size)
        while piece := file.read(PIECE_BYTES):
            whole.update(piece)
            done += len(piece)
            progress("hash", done, now.st_size)
        refuse_change(path, file, (now.st_size, now.st_mtime_ns))
    return LocalFile(path, now.st_size, now.st_mtime_ns, whole.hexdigest())


@dataclass
class Rest:
    """The bytes still to be sent; `offset` is the number of bytes on the server."""

    local: LocalContent
    offset: int


def send_rest(api: Api, address: str, rest: Rest, progress: Report) -> None:
    size_bytes = rest.local.size_bytes
    patience = Patience(PATIENCE_S)
    progress("upload", rest.offset, size_bytes)
    while rest.offset < size_bytes:
        piece = rest.local.read(rest.offset, PIECE_BYTES)
        before = rest.offset
        try:
            rest.offset = _send_piece(api, address, piece, rest.offset)
        except (ServerRefusedError, ServerUnreachableError) as error:
            if not _may_pass(error) or not patience.wait(None):
                raise
            rest.offset = offset_on(api, address)
        if rest.offset > before:
            patience = Patience(PATIENCE_S)
        progress("upload", rest.offset, size_bytes)


def _send_piece(api: Api, address: str, piece: bytes, offset: int) -> int:
    """Send one piece; return the new offset of the server."""
    checksum = base64.b64encode(sha256(piece).digest()).decode("ascii")
    headers = {
        **TUS,
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {checksum}",
        "Content-Type": "application/offset+octet-stream",
    }
    return int(api.send("PATCH", address, content=piece, headers=headers).headers["Upload-Offset"])


def _may_pass(error: ServerRefusedError | ServerUnreachableError) -> bool:
    """Return whether a retry may succeed: a broken connection, a lock, or a damaged piece."""
    return isinstance(error, ServerUnreachableError) or error.status in TRY_AGAIN


def begun(api: Api, local: LocalContent, purpose: Purpose) -> tuple[str, int] | None:
    """Return the started or complete upload of these bytes to this target, with its offset.

    The offset comes from the upload itself, so that a restarted server verifies a complete file.
    """
    item = upload_like(api, local, purpose)
    return None if item is None else (str(item["id"]), offset_on(api, f"/uploads/{item['id']}"))


def upload_like(api: Api, local: LocalContent, purpose: Purpose) -> Mapping[str, Any] | None:
    """Return the upload from the server's list."""
    wanted = (purpose.name, purpose.target_id or None, local.name, local.size_bytes, local.sha256 or None)
    for state in ("open", "complete"):
        for item in api.pages("/uploads", state=state):
            keys = ("purpose", "target_id", "filename", "length_bytes", "declared_sha256")
            if tuple(item[key] for key in keys) == wanted:
                upload: Mapping[str, Any] = item
                return upload
    return None


def upload_metadata(local: LocalContent, purpose: Purpose) -> str:
    """Return the header that describes the bytes."""
    fields = {"filename": local.name, "purpose": purpose.name, "sha256": local.sha256, "target_id": purpose.target_id}
    pairs = ((key, base64.b64encode(value.encode()).decode("ascii")) for key, value in fields.items() if value)
    return ",".join(f"{key} {value}" for key, value in pairs)


def created(api: Api, local: LocalContent, purpose: Purpose, concat: str = "") -> tuple[str, int]:
    """Create the upload; return its id and the server's offset."""
    headers = {**TUS, "Upload-Length": str(local.size_bytes), "Upload-Metadata": upload_metadata(local, purpose)}
    if concat:
        headers["Upload-Concat"] = concat
    made = api.send("POST", "/uploads", headers=headers).headers
    return made["Location"].rpartition("/")[2], int(made["Upload-Offset"])


def offset_on(api: Api, address: str) -> int:
    """Return the server's offset of the upload."""
    return int(api.send("HEAD", address, headers=TUS).headers["Upload-Offset"])
