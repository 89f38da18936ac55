"""Restores a snapshot: objects and uploads first, the database last, in one transaction.

**Conventions.** The target must be an empty platform: a database without tables, a store without objects, no uploads.
An interrupted restore of the same snapshot can be resumed, since keys contain random characters that identify its
objects. Every content is hashed before it is used. Jobs that were running are queued again, without counting the
attempt.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import inspect, text

from services.runtime.backup.errors import DamagedBackupError
from services.runtime.backup.folder import BackupContent, BackupFolder, pieces_of
from services.runtime.backup.snapshot import BackupFile, BackupSnapshot, read_snapshot
from services.runtime.backup.tables import checked_tables, dumped_rows, load
from services.runtime.database.migrate import refuse_unknown, schema_connection
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.lease_sweep import give_back_running
from services.runtime.orm import Blob, GcHoldRow, StoreFault, Upload, Worker
from services.runtime.platform import Platform
from services.runtime.store.protocol import StoredObject
from services.runtime.uploads.files import make_file, upload_file
from services.runtime.uploads.rows import leave
from stone.errors import Refused
from stone_files.atomic import flush

COPIES = 4
RESTORED = Failure("platform_restored", "the platform was restored from a backup taken while this attempt ran")


@dataclass(frozen=True)
class BackupRestoreResult:
    """`flawed` are contents that the platform had lost before the backup."""

    snapshot: BackupSnapshot
    rows: int
    objects: int
    uploads: int
    queued_again: int
    flawed: int


def restore(platform: Platform, folder: BackupFolder, name: str = "") -> BackupRestoreResult:
    """Restore the snapshot `name` (default: the newest); no process of the platform may run meanwhile.

    Raises `snapshot_missing`, `DamagedBackupError`, `target_not_empty`, `schema_newer`, `schema_older`,
    `StoreFullError`, `store_unavailable`.
    """
    snapshot_folder = folder.snapshot(name)
    snapshot, files = read_snapshot(snapshot_folder)
    _refuse(platform, snapshot)
    checked_tables(snapshot_folder, snapshot.tables)
    wanted = dict(_wanted_objects(snapshot_folder, snapshot, files))
    present = {stored.key: stored for stored in platform.store.listed("")}
    _refuse_foreign(platform, wanted, present, files)
    missing = {key: content for key, content in wanted.items() if key not in present}
    flawed = _store(platform, folder, missing, is_flawed=bool(snapshot.flaws))
    uploads = [file for file in files if file.place == "upload"]
    for file in uploads:
        _place_upload(platform, folder, file)
    with schema_connection(platform.settings) as connection:
        load(connection, snapshot_folder, snapshot.revision, snapshot.tables)
    queued_again = _settle(platform, snapshot)
    rows = sum(table.rows for table in snapshot.tables)
    return BackupRestoreResult(snapshot, rows, len(wanted), len(uploads), queued_again, flawed)


def _refuse(platform: Platform, snapshot: BackupSnapshot) -> None:
    refuse_unknown(snapshot.revision)
    if tables := inspect(platform.database.engine).get_table_names():
        raise target_not_empty("the database", f"{len(tables)} tables")


def _wanted_objects(
    snapshot_folder: Path, snapshot: BackupSnapshot, files: tuple[BackupFile, ...]
) -> Iterator[tuple[str, BackupContent]]:
    """Yield the objects of the snapshot by key."""
    rows = dumped_rows(snapshot_folder, snapshot.table(Blob.__tablename__), ("object_key", "sha256", "size_bytes"))
    yield from ((key, BackupContent(sha256, size_bytes)) for key, sha256, size_bytes in rows)
    yield from ((file.name, file.content) for file in files if file.place == "object")


def _refuse_foreign(
    platform: Platform,
    wanted: dict[str, BackupContent],
    present: dict[str, StoredObject],
    files: tuple[BackupFile, ...],
) -> None:
    """Refuse objects and files that are not in this snapshot, because they may belong to another platform."""
    for key, stored in present.items():
        if key not in wanted or wanted[key].size_bytes != stored.size_bytes:
            raise target_not_empty("the store", f"an object {key} that is not in this snapshot")
    folder = platform.settings.uploads_folder
    ours = {file.name for file in files if file.place == "upload"}
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name not in ours:
            raise target_not_empty("the uploads folder", f"a file {path.name} that is not in this snapshot")


def _store(platform: Platform, folder: BackupFolder, missing: dict[str, BackupContent], *, is_flawed: bool) -> int:
    """Restore objects, a few at a time; return the number of flawed objects that the backup lacks."""

    def put(item: tuple[str, BackupContent]) -> int:
        key, content = item
        if is_flawed and not folder.path_of(content.sha256).exists():
            return 1
        platform.store.write(key, folder.checked(content))
        return 0

    with ThreadPoolExecutor(COPIES) as pool:
        return sum(pool.map(put, sorted(missing.items())))


def _place_upload(platform: Platform, folder: BackupFolder, file: BackupFile) -> None:
    path = upload_file(platform.settings, file.name)
    source = folder.checked(file.content)
    path.unlink(missing_ok=True)
    make_file(path)
    with path.open("r+b") as target:
        target.writelines(pieces_of(source))
    flush(path)


def _settle(platform: Platform, snapshot: BackupSnapshot) -> int:
    """Reset the state of ended processes; return the number of jobs that were queued again."""
    with platform.database.transaction() as session:
        for row in (*session.query(GcHoldRow), *session.query(StoreFault), *session.query(Worker)):
            session.delete(row)
        for upload_id in snapshot.given_up:
            upload = session.get(Upload, upload_id)
            if upload is None:
                raise DamagedBackupError(Path(upload_id), "is an abandoned upload of the snapshot, but has no row")
            leave(session, upload, "terminated", "abandoned by the backup")
    queued_again = give_back_running(platform, RESTORED, is_counted=False)
    with platform.database.transaction() as session:
        session.execute(text("ANALYZE"))  # otherwise the first plans are made for empty tables
    return queued_again


def target_not_empty(place: str, content: str) -> Refused:
    return Refused("target_not_empty", f"{place} contains {content}; restore a backup only onto an empty platform")
