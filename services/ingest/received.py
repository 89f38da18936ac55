"""What was received of a recording: its files on this machine, and the bag that they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.orm import Session

from services.ingest.named import named, named_folder
from services.ingest.profiles import Profile
from services.ingest.recording_errors import RecordingFileMissingError, RecordingRefusedError
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Blob, Recording, RecordingFile, Sequence
from services.runtime.platform import Platform
from services.runtime.profiles import topics_of
from services.runtime.uploads import upload_file

NAMES_FOLDER = "names"


@dataclass(frozen=True)
class ReceivedFile:
    """What a row says of one file; `path` is where its bytes lie now."""

    row_id: str
    upload_id: str
    filename: str
    sha256: str
    path: Path


@dataclass(frozen=True)
class Received:
    """A recording as it was received; `folder` is where names of files are kept on this machine.

    `profile` is what its owner chose for the robot.
    """

    recording_id: str
    sequence_id: str
    name: str
    files: tuple[ReceivedFile, ...]
    folder: Path
    profile: Profile

    def bag(self, instead: Mapping[str, Path] | None = None) -> Path:
        """The bag as its owner named it: a file, or a folder with the files.

        `instead` says, by `row_id`, what is read in the place of a file.
        """
        read = [((instead or {}).get(file.row_id, file.path), file.filename) for file in self.files]
        return named(self.folder, *read[0]) if len(read) == 1 else named_folder(self.folder, read, self.name)


def received(platform: Platform, recording_id: str) -> Received:
    """Raises `JobCancelledError` (deleted), `RecordingRefusedError`, `RecordingFileMissingError`."""
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        if recording is None:
            raise JobCancelledError("its recording was deleted")
        files = tuple(_file(session, platform, row) for row in recording.files)
        sequence = session.get_one(Sequence, recording.sequence_id)
        profile = Profile(topics_of(session, sequence), sequence.platform)
    if missing := [file for file in files if not file.path.is_file()]:
        if recording.state == "refused":  # by an attempt that was killed before it could say so
            raise RecordingRefusedError(recording.filename, recording.findings[0]["message"])
        raise RecordingFileMissingError(missing[0].filename, missing[0].upload_id)
    folder = platform.settings.root / NAMES_FOLDER
    return Received(recording_id, sequence.id, recording.filename, files, folder, profile)


def _file(session: Session, platform: Platform, row: RecordingFile) -> ReceivedFile:
    blob = session.get(Blob, row.blob_sha256) if row.blob_sha256 else None
    upload_id = row.upload_id or ""
    path = platform.store.local(blob.object_key) if blob else upload_file(platform.settings, upload_id)
    return ReceivedFile(row.id, upload_id, row.filename, row.sha256, path)
