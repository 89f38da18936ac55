"""Recordings that the platform keeps, located on this machine under the names of their owner.

**Conventions.** A recording is named by the objects that hold its files; locating it brings its bytes to this machine.
"""

from pathlib import Path

from sqlalchemy.orm import Session

from services.runtime.orm import Blob, Recording, RecordingFile
from services.runtime.platform import Platform
from services.runtime.store.named_objects import NAMES_FOLDER, named, named_folder
from stone_recordings.sync.stored_recording import StoredRecording, StoredRecordingFile


def kept_recording(session: Session, recording: Recording) -> StoredRecording:
    """The objects that hold its files."""
    return StoredRecording(recording.filename, tuple(_kept_file(session, file) for file in recording.files))


def locate(platform: Platform, kept: StoredRecording) -> Path:
    """The bag on this machine, a file or a folder, called as its owner called it."""
    if len(kept.files) == 1:
        return locate_file(platform, kept.files[0])
    files = [(platform.store.local(file.object_key), file.filename) for file in kept.files]
    return named_folder(platform.settings.root / NAMES_FOLDER, files, kept.name)


def locate_file(platform: Platform, kept: StoredRecordingFile) -> Path:
    """A file on this machine with the object's bytes, called as its owner called it."""
    return named(platform.settings.root / NAMES_FOLDER, platform.store.local(kept.object_key), kept.filename)


def _kept_file(session: Session, file: RecordingFile) -> StoredRecordingFile:
    """What is read of a file: what was recovered of it, where it was cut off."""
    blob = session.get_one(Blob, file.recovered_blob_sha256 or file.blob_sha256)
    return StoredRecordingFile(blob.object_key, file.filename)
