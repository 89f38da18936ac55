"""Messages of the backup command to the administrator."""

from services.runtime.backup.capture import BackupResult
from services.runtime.backup.folder import BackupFolder
from services.runtime.backup.restore import BackupRestoreResult
from services.runtime.backup.retention import BackupPruneResult, BackupVerification
from services.runtime.backup.snapshot import read_snapshot

MIB = 2**20


def of_backup(taken: BackupResult) -> list[str]:
    rows, snapshot = sum(table.rows for table in taken.snapshot.tables), taken.snapshot
    return [
        f"backed up {rows} rows and {taken.blobs} blobs, of which {taken.brought} files "
        f"({taken.brought_bytes / MIB:.1f} MiB) were new: {taken.folder.name}",
        *(f"DAMAGED on the platform itself: {flaw}" for flaw in snapshot.flaws),
    ]


def of_restored(restored: BackupRestoreResult) -> list[str]:
    said = [
        f"restored {restored.rows} rows, {restored.objects - restored.flawed} objects and {restored.uploads} uploads "
        f"under way; {restored.queued_again} jobs that were running are queued again"
    ]
    if restored.flawed:
        said.append(f"LOST before the backup was taken: {restored.flawed} objects")
    return [*said, *(f"LOST: {flaw}" for flaw in restored.snapshot.flaws)]


def of_verified(verified: BackupVerification) -> list[str]:
    return [
        f"read {verified.contents} contents ({verified.size_bytes / MIB:.1f} MiB) of {verified.snapshots} snapshots",
        *(f"DAMAGED: {sentence}" for sentence in verified.damaged),
    ]


def of_pruned(pruned: BackupPruneResult) -> list[str]:
    return [f"{pruned.snapshots} snapshots and {pruned.contents} contents ({pruned.size_bytes / MIB:.1f} MiB) are gone"]


def of_list(folder: BackupFolder) -> list[str]:
    said = []
    for name in folder.snapshots():
        snapshot, _files = read_snapshot(folder.snapshot(name))
        rows = sum(table.rows for table in snapshot.tables)
        said.append(f"{name}  revision {snapshot.revision}  {rows} rows  {len(snapshot.flaws)} flaws")
    return said
