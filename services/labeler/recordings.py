"""The recordings that labels are made of, located for exports."""

from collections.abc import Collection, Iterable
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.sequences.recordings import kept_recording, locate, locate_joined
from services.runtime.orm import Recording
from services.runtime.platform import Platform
from stone.errors import StoneError
from stone_files.joined_file import JoinedMember, read_joined
from stone_recordings.sync.stored_recording import StoredRecording


class RecordingDeletedError(StoneError):
    """The recording that labels were made of is no longer kept."""

    code = "recording_deleted"

    def __init__(self, recording: str) -> None:
        super().__init__(f"recording {recording} was deleted, so what it holds cannot be exported any more")


def located_recording(platform: Platform, sequence_id: str, sha256s: Collection[str]) -> Path:
    """The bag of the sequence with one of these hashes, on this machine; it may have been deleted and sent again.

    Raises `RecordingDeletedError`.
    """
    with platform.database.reading() as session:
        kept = _kept(session, sequence_id, sha256s)
    if kept is None:
        raise RecordingDeletedError(", ".join(sorted(sha256s)))
    return locate(platform, kept)


def located_members(platform: Platform, sequence_id: str, described: Path) -> Path:
    """The recordings that the `joined.json` in the folder `described` names, joined on this machine as it says.

    Raises `RecordingDeletedError`, `JoinedFileError` (BAG-040).
    """
    members = read_joined(described)
    with platform.database.reading() as session:
        found = {member.name: _kept(session, sequence_id, (member.sha256,)) for member in members}
    kept = {name: recording for name, recording in found.items() if recording is not None}
    if len(kept) < len(found):
        raise RecordingDeletedError(_names(member for member in members if member.name not in kept))
    return locate_joined(platform, kept, described)


def _kept(session: Session, sequence_id: str, sha256s: Collection[str]) -> StoredRecording | None:
    registered = (Recording.sequence_id == sequence_id, Recording.state == "registered")
    same = select(Recording).where(*registered, Recording.sha256.in_(sha256s)).order_by(Recording.id).limit(1)
    recording = session.scalar(same)
    return None if recording is None else kept_recording(session, recording)


def _names(members: Iterable[JoinedMember]) -> str:
    return ", ".join(member.name for member in members)
