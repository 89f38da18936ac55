"""Verification of a folder of backups, and pruning of old snapshots.

**Conventions.** Contents without a snapshot may be deleted only under the folder's lock, because a running backup uses
contents that are not in any snapshot yet.
"""

from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree

from services.runtime.backup.errors import DamagedBackupError
from services.runtime.backup.folder import BackupContent, BackupFolder
from services.runtime.backup.snapshot import read_snapshot
from services.runtime.backup.tables import checked_tables, dumped_rows
from services.runtime.orm import Blob


@dataclass(frozen=True)
class BackupVerification:
    """The number of read contents, and a sentence for each fault."""

    snapshots: int
    contents: int
    size_bytes: int
    damaged: tuple[str, ...]


@dataclass(frozen=True)
class BackupPruneResult:
    """The deleted snapshots and contents: their numbers and bytes."""

    snapshots: int
    contents: int
    size_bytes: int


def verify(folder: BackupFolder) -> BackupVerification:
    """Read every content of every snapshot."""
    wanted: set[BackupContent] = set()
    damaged = []
    names = folder.snapshots()
    for name in names:
        try:
            wanted |= contents_of(folder.snapshot(name))
        except DamagedBackupError as error:
            damaged.append(str(error))
    for content in sorted(wanted, key=lambda content: content.sha256):
        try:
            folder.checked(content)
        except DamagedBackupError as error:
            damaged.append(str(error))
    return BackupVerification(len(names), len(wanted), sum(content.size_bytes for content in wanted), tuple(damaged))


def prune(folder: BackupFolder, kept: int) -> BackupPruneResult:
    """Keep only the newest `kept` snapshots and their contents. Raises `backup_busy`, `DamagedBackupError`."""
    with folder.writing():
        names = folder.snapshots()
        leaving, staying = names[:-kept], names[-kept:]
        wanted = {content.sha256 for name in staying for content in contents_of(folder.snapshot(name))}
        for name in leaving:
            rmtree(folder.snapshot(name))
        gone = [path for path in folder.contents() if path.name not in wanted]
        size_bytes = sum(path.stat().st_size for path in gone)
        for path in gone:
            path.unlink()
        return BackupPruneResult(len(leaving), len(gone), size_bytes)


def contents_of(snapshot_folder: Path) -> set[BackupContent]:
    """Return the contents of a snapshot, except those the platform had lost. Raises `DamagedBackupError`."""
    snapshot, files = read_snapshot(snapshot_folder)
    checked_tables(snapshot_folder, snapshot.tables)
    flawed = " ".join(snapshot.flaws)
    rows = dumped_rows(snapshot_folder, snapshot.table(Blob.__tablename__), ("object_key", "sha256", "size_bytes"))
    named = {BackupContent(sha256, size_bytes) for key, sha256, size_bytes in rows if key not in flawed}
    return named | {file.content for file in files}
