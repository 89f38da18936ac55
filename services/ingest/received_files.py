"""The files of an uploaded recording on this machine, opened as one bag."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.orm import Session

from services.domain.sequences.profiles import topics_of
from services.ingest.errors import RecordingFileMissingError, RecordingRefusedError
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Blob, Recording, RecordingFile, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.named_objects import NAMES_FOLDER, named, named_folder
from services.runtime.uploads.backends import backend_of
from stone_recordings.topics.profiles import TopicProfile


@dataclass(frozen=True)
class ReceivedFile:
    """What a row says of one file; `path` is where its bytes lie now."""

    row_id: str
    upload_id: str
    filename: str
    sha256: str
    path: Path


@dataclass(frozen=True)
class ReceivedBag:
    """A recording as it was received; `folder` is where names of files are kept on this machine.

    `profile` is what its owner chose for the robot.
    """

    recording_id: str
    sequence_id: str
    name: str
    files: tuple[ReceivedFile, ...]
    folder: Path
    profile: TopicProfile

    def bag(self, instead: Mapping[str, Path] | None = None) -> Path:
        """The bag as its owner named it: a file, or a folder with the files.

        `instead` says, by `row_id`, what is read in the place of a file.
        """
        read = [((instead or {}).get(file.row_id, file.path), file.filename) for file in self.files]
        return named(self.folder, *read[0]) if len(read) == 1 else named_folder(self.folder, read, self.name)


@dataclass(frozen=True)
class _StoredFile:
    """Where rows say that the bytes of a file are: in a blob, or else in an upload."""

    row: RecordingFile
    blob: Blob | None
    upload: Upload | None


@contextmanager
def received(platform: Platform, recording_id: str) -> Iterator[ReceivedBag]:
    """The recording with its files on this machine; copies that were made for it go with the block.

    Raises `JobCancelledError` (deleted), `RecordingRefusedError`, `RecordingFileMissingError`, what the store raises.
    """
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        if recording is None:
            raise JobCancelledError("its recording was deleted")
        kept = [_kept(session, row) for row in recording.files]
        sequence = session.get_one(SequenceRow, recording.sequence_id)
        profile = TopicProfile(topics_of(session, sequence), sequence.platform)
    folder = platform.settings.root / NAMES_FOLDER
    with ExitStack() as copies:
        files = tuple(_file(recording, file.row, _path(platform, file, copies)) for file in kept)
        yield ReceivedBag(recording_id, sequence.id, recording.filename, files, folder, profile)


def _kept(session: Session, row: RecordingFile) -> _StoredFile:
    blob = session.get(Blob, row.blob_sha256) if row.blob_sha256 else None
    return _StoredFile(row, blob, session.get(Upload, row.upload_id) if row.upload_id else None)


def _path(platform: Platform, kept: _StoredFile, copies: ExitStack) -> Path | None:
    """Where the bytes are; nothing when they are gone."""
    with suppress(FileNotFoundError, ObjectMissingError):
        if kept.blob is not None:
            return platform.store.local(kept.blob.object_key)
        if kept.upload is not None:
            return copies.enter_context(backend_of(platform, kept.upload).local(kept.upload))
    return None


def _file(recording: Recording, row: RecordingFile, path: Path | None) -> ReceivedFile:
    if path is not None:
        return ReceivedFile(row.id, row.upload_id or "", row.filename, row.sha256, path)
    if recording.state == "refused":  # by an attempt that was killed before it could say so
        raise RecordingRefusedError(recording.filename, recording.findings[0]["message"])
    raise RecordingFileMissingError(row.filename, row.upload_id or "")
