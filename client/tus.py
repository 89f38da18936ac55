"""Sends a file so that it arrives whole: tus 1.0, with a checksum for every piece and the sha256 of the whole.

**Conventions.** An upload is known by (server, target, sha256); its address is kept in a small file until it is
complete, so a client that was killed goes on where the bytes on the server's disk end. Nothing is trusted but that
offset.
"""

import base64
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO

from client.api import PREFIX, Api, Patience
from client.credentials import configuration_folder
from client.errors import FileChangedError, ServerRefusedError, ServerUnreachableError
from client.progress import Report
from services.runtime.atomic import atomic_file

TUS = {"Tus-Resumable": "1.0.0"}
PIECE_BYTES = 16 * 2**20
PATIENCE_S = 120.0
GONE = frozenset({404, 410})
TRY_AGAIN = frozenset({408, 409, 423, 429, 460, 502, 503, 504})


@dataclass(frozen=True)
class Purpose:
    """What the file is for, and for which sequence."""

    name: str
    target_id: str = ""


@dataclass(frozen=True)
class LocalFile:
    """A file as it was when its sha256 was taken."""

    path: Path
    size_bytes: int
    modified_ns: int
    sha256: str

    def refuse_change(self, file: BinaryIO) -> None:
        """Raises `FileChangedError`."""
        now = os.fstat(file.fileno())
        if (now.st_size, now.st_mtime_ns) != (self.size_bytes, self.modified_ns):
            raise FileChangedError(self.path)


def upload_file(api: Api, path: Path, purpose: Purpose, progress: Report) -> str:
    """Send `path`, or what of it the server does not have yet; the id of the complete upload.

    Raises what `Api.send` raises, and `FileChangedError`.
    """
    with path.open("rb") as file:
        local = _hashed(path, file, progress)
        note = _Note(api.url, purpose, local)
        address = note.read()
        offset = _offset(api, address) if address else None
        if offset is None:
            address = _create(api, local, purpose)
            note.write(address)
            offset = _offset(api, address) or 0
        _send_rest(api, address, _Rest(file, local, offset), progress)
    note.forget()
    return address.rpartition("/")[2]


@dataclass
class _Rest:
    """What is still to be sent; `offset` is where the bytes on the server end."""

    file: BinaryIO
    local: LocalFile
    offset: int


def _send_rest(api: Api, address: str, rest: _Rest, progress: Report) -> None:
    size_bytes = rest.local.size_bytes
    patience = Patience(PATIENCE_S)
    progress("upload", rest.offset, size_bytes)
    while rest.offset < size_bytes:
        rest.local.refuse_change(rest.file)
        rest.file.seek(rest.offset)
        piece = rest.file.read(PIECE_BYTES)
        before = rest.offset
        try:
            rest.offset = _send_piece(api, address, piece, rest.offset)
        except (ServerRefusedError, ServerUnreachableError) as error:
            if not _may_pass(error) or not patience.wait(None):
                raise
            rest.offset = _offset(api, address) or 0
        if rest.offset > before:
            patience = Patience(PATIENCE_S)
        progress("upload", rest.offset, size_bytes)


def _send_piece(api: Api, address: str, piece: bytes, offset: int) -> int:
    """Send one piece; where the server's bytes end now."""
    checksum = base64.b64encode(sha256(piece).digest()).decode("ascii")
    headers = {
        **TUS,
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {checksum}",
        "Content-Type": "application/offset+octet-stream",
    }
    return int(api.send("PATCH", address, content=piece, headers=headers).headers["Upload-Offset"])


def _may_pass(error: ServerRefusedError | ServerUnreachableError) -> bool:
    """Whether the next try may fare better: broken connections, a lock, a piece that was damaged on its way."""
    return isinstance(error, ServerUnreachableError) or error.status in TRY_AGAIN


def _create(api: Api, local: LocalFile, purpose: Purpose) -> str:
    """Announce the file; the path of its upload."""
    said = {"filename": local.path.name, "purpose": purpose.name, "sha256": local.sha256}
    if purpose.target_id:
        said["target_id"] = purpose.target_id
    metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode('ascii')}" for key, value in said.items())
    headers = {**TUS, "Upload-Length": str(local.size_bytes), "Upload-Metadata": metadata}
    created = api.send("POST", "/uploads", headers=headers)
    return f"{PREFIX}/uploads/{created.headers['Location'].rpartition('/')[2]}"


def _offset(api: Api, address: str) -> int | None:
    """Where the server's bytes end; None where there is no such upload any more."""
    try:
        return int(api.send("HEAD", address, headers=TUS).headers["Upload-Offset"])
    except ServerRefusedError as error:
        if error.status not in GONE:
            raise
        return None


class _Note:
    """Where the upload of this file to this target is, kept until it is complete."""

    def __init__(self, url: str, purpose: Purpose, local: LocalFile) -> None:
        named = sha256(f"{url} {purpose.name} {purpose.target_id} {local.sha256}".encode()).hexdigest()
        self._path = configuration_folder() / "uploads" / f"{named}.json"

    def read(self) -> str:
        """The path of the upload on the server; empty where none was begun."""
        try:
            return str(json.loads(self._path.read_text("utf-8"))["address"])
        except (FileNotFoundError, ValueError, KeyError, TypeError):  # a damaged note costs sending again, no more
            return ""

    def write(self, address: str) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with atomic_file(self._path) as staging:
            staging.write_text(json.dumps({"address": address}), "utf-8")

    def forget(self) -> None:
        self._path.unlink(missing_ok=True)


def _hashed(path: Path, file: BinaryIO, progress: Report) -> LocalFile:
    now = os.fstat(file.fileno())
    whole, done = sha256(), 0
    for piece in _pieces(file):
        whole.update(piece)
        done += len(piece)
        progress("hash", done, now.st_size)
    local = LocalFile(path, now.st_size, now.st_mtime_ns, whole.hexdigest())
    local.refuse_change(file)
    return local


def _pieces(file: BinaryIO) -> Iterator[bytes]:
    while piece := file.read(PIECE_BYTES):
        yield piece
