"""What befalls uploads besides bytes: they are completed, used, recorded, overdue."""

from sqlalchemy import update

from services.runtime.access.storage_quota import balance
from services.runtime.orm import Recording, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep
from services.runtime.uploads import consume
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.rows import UploadOwner
from testing.worlds.rows import recording_of
from tests.services.runtime.uploads.sending import BAG, made, send


def used(platform: Platform, owner: UploadOwner) -> int:
    with platform.database.reading() as session:
        return balance(session, owner.user_id)


def overdue(platform: Platform, upload: Upload) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(expires_ns=1))


def make_sequence(platform: Platform, owner: UploadOwner, name: str = "field") -> str:
    with platform.database.transaction() as session:
        sequence = SequenceRow(owner_id=owner.user_id, name=name)
        session.add(sequence)
        session.flush()
        return sequence.id


def complete(platform: Platform, owner: UploadOwner, content: bytes = BAG) -> Upload:
    return send(platform, made(platform, owner, content), 0, content)


def leave_unsettled(platform: Platform, upload: Upload, content: bytes) -> None:
    """All bytes came, and the process died before it could say that the upload is complete."""
    held = backend_of(platform, upload).hold(upload)
    held.append([content], 0)
    held.accept(is_whole=True)
    held.close()


def record(platform: Platform, owner: UploadOwner, upload: Upload, name: str = "field") -> Recording:
    """As the register stage leaves it: the bytes are a blob, the recording names it."""
    sequence_id = make_sequence(platform, owner, name)
    with backend_of(platform, upload).local(upload) as path, platform.database.transaction() as session:
        consume(session, upload.id, owner.user_id, "recording")
        blob = keep(session, platform.store, path, adopt=True)
        recording = recording_of(upload, sequence_id, "registered", blob.sha256)
        session.add(recording)
    return recording
