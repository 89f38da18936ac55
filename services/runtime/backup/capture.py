"""Creates a backup: a database snapshot, then the stored objects that it refers to.

**Conventions.** The platform continues to run. Objects that the platform itself has lost or damaged are flaws: they are
reported, and everything else is backed up. An outage of database or store ends the backup; the next backup reuses the
copied contents.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, and_, or_, select

from services.runtime.backup.errors import SourceDamagedError
from services.runtime.backup.folder import BackupContent, BackupFolder, pieces_of
from services.runtime.backup.snapshot import BackupFile, BackupSnapshot, write_files, write_snapshot
from services.runtime.backup.tables import TableFacts, dump, dumped_rows, snapshot_of
from services.runtime.code_version import RELEASE
from services.runtime.database.migrate import head_revision
from services.runtime.orm import Base, Blob, DatasetImport, Job, RecordingFile, SubmissionRow, Upload, UploadPartRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.free_space import NO_RESERVE, require_room
from services.runtime.store.garbage_collection import KEPT_FAILED_NS, WORK
from services.runtime.store.gc_holds import gc_hold
from services.runtime.store.keys import ObjectMissingError
from services.runtime.uploads.files import offset_of, upload_file
from services.runtime.uploads.part_rows import STORE
from services.runtime.uploads.rows import GONE

# References of a database state to data outside of it: blobs, work files of unfinished runs, unfinished uploads. They
# are read within the snapshot's own transaction, except for potentially many: blobs and upload parts (bytes in the
# store) are read from the written rows. Only uploads in the folder are included. A run is over if it succeeded, or
# failed so long ago that its work is not kept (`garbage_collection`).


@dataclass(frozen=True)
class BackupUpload:
    """An upload whose bytes are only in the folder; `sha256` is empty until the upload is complete."""

    id: str
    sha256: str


@dataclass(frozen=True)
class BackupReferences:
    """Ids of the runs whose work is needed, and the uploads whose bytes are needed."""

    runs: frozenset[str]
    uploads: tuple[BackupUpload, ...]


def backup_references(connection: Connection) -> BackupReferences:
    return BackupReferences(frozenset(_runs(connection)), tuple(_uploads(connection)))


def _runs(connection: Connection) -> list[str]:
    kept_ns = now_ns() - KEPT_FAILED_NS
    needed = or_(Job.finished_ns.is_(None), (Job.state != "succeeded") & (Job.finished_ns > kept_ns))
    return list(connection.scalars(select(Job.id).where(Job.id == Job.root_id, needed)))


def _uploads(connection: Connection) -> list[BackupUpload]:
    """Return unfinished and complete uploads, and consumed uploads that have no blob yet."""
    used = Upload.state == "consumed"
    recorded = select(RecordingFile.upload_id).where(RecordingFile.blob_sha256.is_(None))
    submitted = select(SubmissionRow.upload_id).where(SubmissionRow.blob_sha256.is_(None))
    unread = (DatasetImport.blob_sha256.is_(None), DatasetImport.finished_ns.is_(None))
    imported = select(DatasetImport.upload_id).where(*unread)
    needed = or_(
        Upload.state.in_(("open", "complete")),
        and_(used, Upload.purpose.not_in(("recording", "submission", "dataset"))),
        and_(used, Upload.purpose == "recording", Upload.id.in_(recorded)),
        and_(used, Upload.purpose == "submission", Upload.id.in_(submitted)),
        and_(used, Upload.purpose == "dataset", Upload.id.in_(imported)),
    )
    rows = connection.execute(
        select(Upload.id, Upload.sha256).where(Upload.backend != STORE, needed).order_by(Upload.id)
    )
    return [BackupUpload(upload_id, sha256) for upload_id, sha256 in rows]


COPIES = 4
AHEAD = 64


@dataclass(frozen=True)
class BackupResult:
    """`brought` counts contents that were not in earlier backups."""

    folder: Path
    snapshot: BackupSnapshot
    blobs: int
    brought: int
    brought_bytes: int


@dataclass
class _BackupWriter:
    """The writer of one backup."""

    platform: Platform
    folder: BackupFolder
    files: list[BackupFile] = field(default_factory=list)
    flaws: list[str] = field(default_factory=list)
    given_up: list[str] = field(default_factory=list)
    blobs: int = 0
    brought: int = 0
    brought_bytes: int = 0

    def bring_blobs(self, rows: Iterable[list[object]]) -> None:
        """Copy the blobs of the rows (sha256, object_key, size_bytes)."""
        contents = ((BackupContent(str(sha256), int(str(size))), str(key)) for sha256, key, size in rows)
        with ThreadPoolExecutor(COPIES) as pool:
            for content, flaw in _few_ahead(pool, self._bring_blob, contents):
                self.blobs += 1
                if flaw:
                    self.flaws.append(flaw)
                elif content is not None:
                    self._count(content)

    def bring_upload_parts(self, rows: Iterable[list[object]]) -> None:
        """Copy the objects of the rows (object_key, blob_sha256), each once; objects of blobs are already copied."""
        for key in sorted({str(key) for key, blob_sha256 in rows if blob_sha256 is None}):
            try:
                self._keep(BackupFile("object", key, self.folder.add(key, self.platform.store.read(key))))
            except ObjectMissingError as error:
                self.flaws.append(str(error))

    def bring_work(self, runs: frozenset[str]) -> None:
        store = self.platform.store
        for stored in store.listed(WORK):
            if stored.key.split("/")[1] in runs:
                try:
                    content = self.folder.add(stored.key, store.read(stored.key))
                except ObjectMissingError:  # deleted by its job; no row refers to a workspace file
                    continue
                self._keep(BackupFile("object", stored.key, content))

    def bring_upload(self, upload: BackupUpload) -> None:
        """Copy its counted bytes, at least those at the time of the snapshot."""
        path = upload_file(self.platform.settings, upload.id)
        try:
            content = self.folder.add(path.name, pieces_of(path, offset_of(path)), upload.sha256)
        except FileNotFoundError:
            self._bring_ended(upload)
        except SourceDamagedError as error:
            self.flaws.append(str(error))
        else:
            self._keep(BackupFile("upload", upload.id, content))

    def _bring_ended(self, upload: BackupUpload) -> None:
        """Handle an upload that became a blob after the snapshot, was abandoned, or whose file was lost before."""
        with self.platform.database.reading() as session:
            row = session.get_one(Upload, upload.id)
            blob = session.scalar(select(Blob).where(Blob.sha256 == row.sha256)) if row.sha256 else None
        if blob is not None:
            content = self.folder.add(upload.id, self.platform.store.read(blob.object_key), blob.sha256)
            self._keep(BackupFile("upload", upload.id, content))
        elif row.state in GONE:
            self.given_up.append(upload.id)
        else:
            self.flaws.append(f"upload {upload.id} has no file")

    def _bring_blob(self, named: tuple[BackupContent, str]) -> tuple[BackupContent | None, str]:
        """Return the copied content, if a copy was needed, and the flaw, if any."""
        content, key = named
        if self.folder.has(content):
            return None, ""
        try:
            return self.folder.add(key, self.platform.store.read(key), content.sha256), ""
        except (ObjectMissingError, SourceDamagedError) as error:
            return None, str(error)

    def _keep(self, file: BackupFile) -> None:
        self.files.append(file)
        self._count(file.content)

    def _count(self, content: BackupContent) -> None:
        self.brought += 1
        self.brought_bytes += content.size_bytes


def make_backup(platform: Platform, folder: BackupFolder) -> BackupResult:
    """Back up the current database, store and uploads.

    Raises `backup_busy`, `schema_not_current`, `HoldLostError`, `store_unavailable`, `StorageFullError`, `OSError`.
    """
    writer = _BackupWriter(platform, folder)
    with folder.writing(), gc_hold(platform.database, "backup") as hold, folder.new_snapshot() as snapshot_folder:
        made_ns = now_ns()
        tables, named = _dump_database(platform, snapshot_folder)
        contents = partial(dumped_rows, snapshot_folder, _named(tables, Blob), ("sha256", "object_key", "size_bytes"))
        _require_room(platform, folder, contents())
        writer.bring_blobs(contents())
        writer.bring_upload_parts(
            dumped_rows(snapshot_folder, _named(tables, UploadPartRow), ("object_key", "blob_sha256"))
        )
        writer.bring_work(named.runs)
        for upload in named.uploads:
            writer.bring_upload(upload)
        snapshot = BackupSnapshot(
            head_revision(),
            RELEASE,
            made_ns,
            tables,
            write_files(snapshot_folder, tuple(writer.files)),
            tuple(writer.flaws),
            tuple(writer.given_up),
        )
        write_snapshot(snapshot_folder, snapshot)
        hold.check()
    return BackupResult(folder.snapshot(), snapshot, writer.blobs, writer.brought, writer.brought_bytes)


def _require_room(platform: Platform, folder: BackupFolder, rows: Iterable[list[object]]) -> None:
    """Raise `StorageFullError` if the new contents do not fit; the platform's own disk keeps its reserve."""
    contents = (BackupContent(str(sha256), int(str(size))) for sha256, _, size in rows)
    new_bytes = sum(content.size_bytes for content in contents if not folder.has(content))
    is_ours = folder.root.stat().st_dev == platform.settings.root.stat().st_dev
    require_room(folder.root, new_bytes, platform.settings.store.reserve_bytes if is_ours else NO_RESERVE)


def _named(tables: tuple[TableFacts, ...], row: type[Base]) -> TableFacts:
    return next(table for table in tables if table.name == row.__tablename__)


def _dump_database(platform: Platform, snapshot_folder: Path) -> tuple[tuple[TableFacts, ...], BackupReferences]:
    """Dump the current database; the transaction ends before anything slow is copied."""
    with snapshot_of(platform.database) as connection:
        return dump(connection, snapshot_folder), backup_references(connection)


def _few_ahead(
    pool: ThreadPoolExecutor,
    act: Callable[[tuple[BackupContent, str]], tuple[BackupContent | None, str]],
    items: Iterable[tuple[BackupContent, str]],
) -> Iterator[tuple[BackupContent | None, str]]:
    """Yield the results of `act`, in order, with at most `AHEAD` calls in progress."""
    waiting = []
    for item in items:
        waiting.append(pool.submit(act, item))
        if len(waiting) >= AHEAD:
            yield waiting.pop(0).result()
    for outcome in waiting:
        yield outcome.result()
