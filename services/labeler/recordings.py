"""The recordings that labels are made of, located for exports."""

from collections.abc import Collection
from pathlib import Path

from sqlalchemy import select

from services.domain.sequences.recording_sources import kept_recording, locate
from services.runtime.orm import Recording
from services.runtime.platform import Platform
from stone.errors import StoneError


class RecordingDeletedError(StoneError):
    """The recording that labels were made of is no longer kept."""

    code = "recording_deleted"

    def __init__(self, recording: str) -> None:
        super().__init__(f"recording {recording} was deleted, so what it holds cannot be exported any more")


def located_recording(platform: Platform, sequence_id: str, sha256s: Collection[str]) -> Path:
    """The bag of the sequence with one of these hashes, on this machine; it may have been deleted and sent again.

    Raises `RecordingDeletedError`.
    """
    registered = (Recording.sequence_id == sequence_id, Recording.state == "registered")
    same = select(Recording).where(*registered, Recording.sha256.in_(sha256s)).order_by(Recording.id).limit(1)
    with platform.database.reading() as session:
        recording = session.scalar(same)
        if recording is None:
            raise RecordingDeletedError(", ".join(sorted(sha256s)))
        kept = kept_recording(session, recording)
    return locate(platform, kept)
