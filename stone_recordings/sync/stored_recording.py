"""A recording as objects of a store, or as files in place, and the names of its files."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self


@dataclass(frozen=True)
class StoredRecordingFile:
    """An object of the store, and the name that its owner gave it."""

    object_key: str
    filename: str


@dataclass(frozen=True)
class PlacedFile:
    """A file in place at its registration; `version` is its time of change in ns, or an object's ETag."""

    name: str
    size_bytes: int
    version: str


@dataclass(frozen=True)
class RecordingPlace:
    """A recording in place: `path` below `root`, a name in the settings; `files` after it was read.

    Pictures of a recording in a bucket are read only `with_pictures`.
    """

    root: str
    path: str
    files: tuple[PlacedFile, ...] = ()
    with_pictures: bool = False

    @property
    def name(self) -> str:
        """The recording's name: that of its file, or of the folder of its files."""
        return self.path.rpartition("/")[2]

    @property
    def size_bytes(self) -> int:
        return sum(file.size_bytes for file in self.files)

    def __str__(self) -> str:
        return f"{self.root}:{self.path}"

    def as_record(self) -> dict[str, Any]:
        """Return the value for a database row."""
        return asdict(self)

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Self:
        """Return the value that `as_record` wrote."""
        files = tuple(PlacedFile(**file) for file in record["files"])
        return cls(record["root"], record["path"], files, record["with_pictures"])


@dataclass(frozen=True)
class StoredRecording:
    """A recording in the store: one file, or the files of a bag called `name`; or one in `place`."""

    name: str
    files: tuple[StoredRecordingFile, ...]
    place: RecordingPlace | None = None
