"""Short words for the tests of uploads: owners, declarations, pieces sent without HTTP."""

import hashlib
from pathlib import Path

from services.runtime.orm import Upload, User
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from services.runtime.uploads.creation import UploadDeclaration, create
from services.runtime.uploads.files import offset_of
from services.runtime.uploads.part_rows import upload_parts_of
from services.runtime.uploads.reception import Checksum, UploadChunk, UploadReceiver, receive
from services.runtime.uploads.rows import UploadOwner, find

CONTENT = bytes(range(256)) * 40
BAG = b"a bag of bytes" * 100
WRONG = Checksum("sha1", b"\0" * 20)


def right(content: bytes) -> Checksum:
    return Checksum("sha1", hashlib.sha1(content).digest())


def make_owner(platform: Platform, name: str = "ada", role: str = "curator") -> UploadOwner:
    with platform.database.transaction() as session:
        user = User(name=name, role=role)
        session.add(user)
        session.flush()
        return UploadOwner(user.id, role == "administrator")


def declared(content: bytes, *, sha256: str = "", target_id: str = "", purpose: str = "recording") -> UploadDeclaration:
    return UploadDeclaration("run.mcap", purpose, len(content), target_id, sha256)


def sha256_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def made(platform: Platform, owner: UploadOwner, content: bytes, *, sha256: str = "") -> Upload:
    return create(platform, owner, declared(content, sha256=sha256))


def receiving(platform: Platform, upload: Upload, chunk: UploadChunk) -> UploadReceiver:
    """A request that has begun, of bytes that the upload lacks."""
    reception = receive(platform, upload.id, upload.owner_id, chunk)
    assert reception is not None
    return reception


def send(
    platform: Platform, upload: Upload, offset_bytes: int, content: bytes, checksum: Checksum | None = None
) -> Upload:
    """One whole request; the upload as it is afterwards."""
    reception = receive(platform, upload.id, upload.owner_id, UploadChunk(offset_bytes, len(content), checksum))
    if reception is None:
        return find(platform.database, upload.id, upload.owner_id)
    try:
        half = len(content) // 2
        reception.write([content[:half], content[half:]])
        return reception.end()
    finally:
        reception.close()


def kept(platform: Platform, upload: Upload) -> bytes:
    """The bytes that count, wherever they are; none when they are gone."""
    if upload.backend == "folder":
        path = path_of(platform, upload)
        return path.read_bytes()[: offset_of(path)] if path.exists() else b""
    with platform.database.reading() as session:
        slabs = upload_parts_of(session, upload.id)
    return b"".join(b"".join(platform.store.read(part.key)) for part in slabs)


def path_of(platform: Platform, upload: Upload) -> Path:
    return upload_file(platform.settings, upload.id)


def state_of(platform: Platform, upload: Upload) -> str:
    return find(platform.database, upload.id, upload.owner_id).state
