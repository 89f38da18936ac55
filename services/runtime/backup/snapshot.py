"""The record of a snapshot, and its file format.

**Conventions.** `snapshot.json` contains the hashes of all other files of the snapshot, and its own name, which a
restore reports. Invalid lines are refused.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from services.runtime.backup.errors import DamagedBackupError
from services.runtime.backup.folder import BackupContent, sha256_of
from services.runtime.backup.tables import TableFacts

SNAPSHOT, FILES = "snapshot.json", "files.json"


@dataclass(frozen=True)
class BackupFile:
    """A file that is not a blob: an object of the store by its key, or an upload's bytes in the uploads folder."""

    place: Literal["object", "upload"]
    name: str
    content: BackupContent


@dataclass(frozen=True)
class BackupSnapshot:
    """`flaws` are objects that the platform itself had lost or damaged; `given_up` are uploads that ended meanwhile."""

    revision: str
    code_version: str
    made_ns: int
    tables: tuple[TableFacts, ...]
    files_sha256: str
    flaws: tuple[str, ...] = ()
    given_up: tuple[str, ...] = ()
    format: Literal[1] = 1

    def table(self, name: str) -> TableFacts:
        return next(table for table in self.tables if table.name == name)


_SNAPSHOT, _FILES = TypeAdapter(BackupSnapshot), TypeAdapter(tuple[BackupFile, ...])


def write_files(folder: Path, files: tuple[BackupFile, ...]) -> str:
    """Write the file list; return its sha256."""
    (folder / FILES).write_bytes(_FILES.dump_json(files, indent=1))
    return sha256_of(folder / FILES)


def write_snapshot(folder: Path, snapshot: BackupSnapshot) -> None:
    (folder / SNAPSHOT).write_bytes(_SNAPSHOT.dump_json(snapshot, indent=1))


def read_snapshot(folder: Path) -> tuple[BackupSnapshot, tuple[BackupFile, ...]]:
    """Return the snapshot and its files. Raises `DamagedBackupError`."""
    try:
        snapshot = _SNAPSHOT.validate_json((folder / SNAPSHOT).read_bytes())
        if sha256_of(folder / FILES) != snapshot.files_sha256:
            raise DamagedBackupError(folder / FILES, "differs from the snapshot's record")
        return snapshot, _FILES.validate_json((folder / FILES).read_bytes())
    except (OSError, ValidationError) as error:
        raise DamagedBackupError(folder / SNAPSHOT, f"cannot be read: {error}") from error
