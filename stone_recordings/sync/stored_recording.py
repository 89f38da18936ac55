"""A recording as objects of a store, or as files that stay where their owner has them, and the names of its files."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self


@dataclass(frozen=True)
class StoredRecordingFile:
    """An object of the store, and the name its owner gave it."""

    object_key: str
    filename: str


@dataclass(frozen=True)
class PlacedFile:
    """A file in place as it was registered; `version` is its time of change in ns, or an object's ETag."""

    name: str
    size_bytes: int
    version: str


@dataclass(frozen=True)
class RecordingPlace:
    """A recording that stays where it lies: `path` below `root`, a name in the settings. `files` once it was read.

    From a bucket, pictures are read only `with_pictures`.
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
        """The value as a row keeps it."""
        return asdict(self)

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Self:
        """The value that `as_record` wrote."""
        files = tuple(PlacedFile(**file) for file in record["files"])
        return cls(record["root"], record["path"], files, record["with_pictures"])


@dataclass(frozen=True)
class StoredRecording:
    """A recording in the store: one file, or the files of a bag that is called `name`; or one in `place`."""

    name: str
    files: tuple[StoredRecordingFile, ...]
    place: RecordingPlace | None = None
