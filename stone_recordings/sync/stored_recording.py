"""A recording as objects of a store, and the names that their owner gave them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StoredRecordingFile:
    """An object of the store, and the name its owner gave it."""

    object_key: str
    filename: str


@dataclass(frozen=True)
class StoredRecording:
    """A recording in the store: one file, or the files of a bag that is called `name`."""

    name: str
    files: tuple[StoredRecordingFile, ...]
