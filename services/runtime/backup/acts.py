"""An administrator's commands on backups: take, list, verify, prune, restore; each with its messages."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from services.runtime.backup.capture import BackupResult, make_backup
from services.runtime.backup.folder import BackupFolder
from services.runtime.backup.restore import BackupRestoreResult, restore
from services.runtime.backup.retention import BackupPruneResult, BackupVerification, prune, verify
from services.runtime.backup.snapshot import read_snapshot
from services.runtime.embedded.listen_socket import hold_folder
from services.runtime.platform import Platform, open_silent_platform
from services.runtime.settings import Settings

MIB = 2**20


@dataclass(frozen=True)
class BackupOutcome:
    """Messages for people, a record for programs, and whether nothing is damaged or lost."""

    lines: tuple[str, ...]
    record: Mapping[str, Any]
    is_well: bool = True


def take_backup(settings: Settings, folder: BackupFolder) -> BackupOutcome:
    """Back up the platform of these settings. Raises what `make_backup` raises."""
    with _open_platform(settings) as platform:
        taken = make_backup(platform, folder)
    record = {"snapshot": taken.folder.name, "blobs": taken.blobs, "new": taken.brought, "bytes": taken.brought_bytes}
    return BackupOutcome(of_backup(taken), record, not taken.snapshot.flaws)


def restore_backup(settings: Settings, folder: BackupFolder, snapshot: str) -> BackupOutcome:
    """Restore a snapshot (empty: the newest) while no embedded platform can start. Raises what `restore` raises."""
    with ExitStack() as stack:
        stack.enter_context(hold_folder(settings.root))
        restored = restore(stack.enter_context(_open_platform(settings)), folder, snapshot)
    record = {"rows": restored.rows, "objects": restored.objects, "lost": restored.flawed}
    return BackupOutcome(of_restored(restored), record, not restored.snapshot.flaws)


def verify_backups(folder: BackupFolder) -> BackupOutcome:
    verified = verify(folder)
    record = {"snapshots": verified.snapshots, "contents": verified.contents, "damaged": list(verified.damaged)}
    return BackupOutcome(of_verified(verified), record, not verified.damaged)


def prune_backups(folder: BackupFolder, keep: int) -> BackupOutcome:
    pruned = prune(folder, keep)
    record = {"snapshots": pruned.snapshots, "contents": pruned.contents, "bytes": pruned.size_bytes}
    return BackupOutcome(of_pruned(pruned), record)


def list_backups(folder: BackupFolder) -> BackupOutcome:
    """Return one line and one record for each snapshot, the oldest first."""
    records = []
    for name in folder.snapshots():
        snapshot, _files = read_snapshot(folder.snapshot(name))
        rows = sum(table.rows for table in snapshot.tables)
        records.append({"name": name, "revision": snapshot.revision, "rows": rows, "flaws": len(snapshot.flaws)})
    lines = (
        f"{record['name']}  revision {record['revision']}  {record['rows']} rows  {record['flaws']} flaws"
        for record in records
    )
    return BackupOutcome(tuple(lines), {"snapshots": records})


@contextmanager
def _open_platform(settings: Settings) -> Iterator[Platform]:
    platform = open_silent_platform(settings)
    try:
        yield platform
    finally:
        platform.database.close()


def of_backup(taken: BackupResult) -> tuple[str, ...]:
    rows, snapshot = sum(table.rows for table in taken.snapshot.tables), taken.snapshot
    return (
        f"backed up {rows} rows and {taken.blobs} blobs; {taken.brought} files ({taken.brought_bytes / MIB:.1f} MiB) "
        f"were new: {taken.folder.name}",
        *(f"DAMAGED on the platform itself: {flaw}" for flaw in snapshot.flaws),
    )


def of_restored(restored: BackupRestoreResult) -> tuple[str, ...]:
    lines = [
        f"restored {restored.rows} rows, {restored.objects - restored.flawed} objects and {restored.uploads} "
        f"unfinished uploads; {restored.queued_again} interrupted jobs are queued again"
    ]
    if restored.flawed:
        lines.append(f"LOST before the backup was taken: {restored.flawed} objects")
    return (*lines, *(f"LOST: {flaw}" for flaw in restored.snapshot.flaws))


def of_verified(verified: BackupVerification) -> tuple[str, ...]:
    return (
        f"read {verified.contents} contents ({verified.size_bytes / MIB:.1f} MiB) of {verified.snapshots} snapshots",
        *(f"DAMAGED: {sentence}" for sentence in verified.damaged),
    )


def of_pruned(pruned: BackupPruneResult) -> tuple[str, ...]:
    return (f"deleted {pruned.snapshots} snapshots and {pruned.contents} contents ({pruned.size_bytes / MIB:.1f} MiB)",)
