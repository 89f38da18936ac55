"""Recordings that the platform keeps, located on this machine under the names of their owner.

**Conventions.** A recording is named by the objects that hold its files; locating it brings its bytes to this machine.
Several that are one run are located as the folder of a joined recording, which `joined.json` describes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from sqlalchemy.orm import Session

from services.runtime.orm import Blob, Recording, RecordingFile
from services.runtime.platform import Platform
from services.runtime.store.named_objects import NAMES_FOLDER, described_folder, named, named_folder
from stone_files.joined_file import JOINED, JoinedFileError, read_joined
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


def locate_run(platform: Platform, kept: Sequence[StoredRecording], described: Path) -> Path:
    """The recordings of a run as one bag on this machine; of several, the folder `described` holds `joined.json`.

    Raises `JoinedFileError` (BAG-040) where that describes others.
    """
    if len(kept) == 1:
        return locate(platform, kept[0])
    return locate_joined(platform, {recording.name: recording for recording in kept}, described)


def locate_joined(platform: Platform, kept: Mapping[str, StoredRecording], described: Path) -> Path:
    """The folder of a joined recording on this machine: `kept` are its members, by name. Raises as `locate_run`."""
    names = {member.name for member in read_joined(described)}
    if names != set(kept):
        problem = f"it is of {', '.join(sorted(names))}, the run of {', '.join(sorted(kept))}"
        raise JoinedFileError(described.name, problem)
    bags = {name: locate(platform, recording) for name, recording in kept.items()}
    description = (JOINED, (described / JOINED).read_bytes())
    return described_folder(platform.settings.root / NAMES_FOLDER, bags, description, "joined")


def locate_file(platform: Platform, kept: StoredRecordingFile) -> Path:
    """A file on this machine with the object's bytes, called as its owner called it."""
    return named(platform.settings.root / NAMES_FOLDER, platform.store.local(kept.object_key), kept.filename)


def _kept_file(session: Session, file: RecordingFile) -> StoredRecordingFile:
    """What is read of a file: what was recovered of it, where it was cut off."""
    blob = session.get_one(Blob, file.recovered_blob_sha256 or file.blob_sha256)
    return StoredRecordingFile(blob.object_key, file.filename)
