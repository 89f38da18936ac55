"""Short words for the tests of uploads: owners, declarations, pieces sent without HTTP."""

import hashlib
from pathlib import Path

from services.runtime.orm import Upload, User
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from services.runtime.uploads.creating import create
from services.runtime.uploads.declared import Declared
from services.runtime.uploads.receiving import Checksum, Piece, receive
from services.runtime.uploads.rows import Owner, find


def make_owner(platform: Platform, name: str = "ada", role: str = "curator") -> Owner:
    with platform.database.transaction() as session:
        user = User(name=name, role=role)
        session.add(user)
        session.flush()
        return Owner(user.id, role == "administrator")


def declared(content: bytes, *, sha256: str = "", target_id: str = "", purpose: str = "recording") -> Declared:
    return Declared("run.mcap", purpose, len(content), target_id, sha256)


def sha256_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def made(platform: Platform, owner: Owner, content: bytes, *, sha256: str = "") -> Upload:
    return create(platform, owner, declared(content, sha256=sha256))


def send(
    platform: Platform, upload: Upload, offset_bytes: int, content: bytes, checksum: Checksum | None = None
) -> Upload:
    """One whole request; the upload as it is afterwards."""
    reception = receive(platform, upload.id, upload.owner_id, Piece(offset_bytes, len(content), checksum))
    if reception is None:
        return find(platform.database, upload.id, upload.owner_id)
    try:
        half = len(content) // 2
        reception.write([content[:half], content[half:]])
        return reception.end()
    finally:
        reception.close()


def path_of(platform: Platform, upload: Upload) -> Path:
    return upload_file(platform.settings, upload.id)


def state_of(platform: Platform, upload: Upload) -> str:
    return find(platform.database, upload.id, upload.owner_id).state
