"""A backup is taken: the snapshot, then what it names, then it appears.

**Conventions.** Work goes on meanwhile. What the snapshot names and the platform itself has lost or damaged is a flaw:
it is said and everything else is kept. An outage of database or store ends the backup; the next one finds what was
brought already.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import select

from services.runtime.backup.errors import SourceDamagedError
from services.runtime.backup.folder import BackupFolder, Content, pieces_of
from services.runtime.backup.named import Named, NamedUpload, named_by
from services.runtime.backup.snapshot import KeptFile, Snapshot, write_files, write_snapshot
from services.runtime.backup.tables import TableFacts, dump, dumped_rows, snapshot_of
from services.runtime.collection import WORK
from services.runtime.holding import collection_held
from services.runtime.migrate import head_revision
from services.runtime.orm import Base, Blob, Upload, UploadSlab
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.recipes import CODE_VERSION
from services.runtime.store_keys import ObjectMissingError
from services.runtime.uploads.files import offset_of, upload_file
from services.runtime.uploads.rows import GONE

COPIES = 4
AHEAD = 64


@dataclass(frozen=True)
class Taken:
    """`brought` is what was not there from earlier backups."""

    folder: Path
    snapshot: Snapshot
    blobs: int
    brought: int
    brought_bytes: int


@dataclass
class _Haul:
    """What one backup brings."""

    platform: Platform
    folder: BackupFolder
    files: list[KeptFile] = field(default_factory=list)
    flaws: list[str] = field(default_factory=list)
    given_up: list[str] = field(default_factory=list)
    blobs: int = 0
    brought: int = 0
    brought_bytes: int = 0

    def bring_blobs(self, rows: Iterable[list[object]]) -> None:
        """`rows` are (sha256, object_key, size_bytes)."""
        contents = ((Content(str(sha256), int(str(size))), str(key)) for sha256, key, size in rows)
        with ThreadPoolExecutor(COPIES) as pool:
            for content, flaw in _few_ahead(pool, self._bring_blob, contents):
                self.blobs += 1
                if flaw:
                    self.flaws.append(flaw)
                elif content is not None:
                    self._count(content)

    def bring_slabs(self, rows: Iterable[list[object]]) -> None:
        """`rows` are (object_key, blob_sha256); several may name one object, and that of a blob is brought already."""
        for key in sorted({str(key) for key, blob_sha256 in rows if blob_sha256 is None}):
            try:
                self._keep(KeptFile("object", key, self.folder.add(key, self.platform.store.read(key))))
            except ObjectMissingError as error:
                self.flaws.append(str(error))

    def bring_work(self, runs: frozenset[str]) -> None:
        store = self.platform.store
        for stored in store.listed(WORK):
            if stored.key.split("/")[1] in runs:
                try:
                    content = self.folder.add(stored.key, store.read(stored.key))
                except ObjectMissingError:  # of a job that took it back; no row names a file of a workspace
                    continue
                self._keep(KeptFile("object", stored.key, content))

    def bring_upload(self, upload: NamedUpload) -> None:
        """Its bytes as far as they count, at least those of the snapshot's moment."""
        path = upload_file(self.platform.settings, upload.id)
        try:
            content = self.folder.add(path.name, pieces_of(path, offset_of(path)), upload.sha256)
        except FileNotFoundError:
            self._bring_ended(upload)
        except SourceDamagedError as error:
            self.flaws.append(str(error))
        else:
            self._keep(KeptFile("upload", upload.id, content))

    def _bring_ended(self, upload: NamedUpload) -> None:
        """It became a blob since the snapshot, or was given up, or its file was lost before."""
        with self.platform.database.reading() as session:
            row = session.get_one(Upload, upload.id)
            blob = session.scalar(select(Blob).where(Blob.sha256 == row.sha256)) if row.sha256 else None
        if blob is not None:
            content = self.folder.add(upload.id, self.platform.store.read(blob.object_key), blob.sha256)
            self._keep(KeptFile("upload", upload.id, content))
        elif row.state in GONE:
            self.given_up.append(upload.id)
        else:
            self.flaws.append(f"upload {upload.id} has no file")

    def _bring_blob(self, named: tuple[Content, str]) -> tuple[Content | None, str]:
        """What was brought, if anything had to be; the flaw, if there is one."""
        content, key = named
        if self.folder.has(content):
            return None, ""
        try:
            return self.folder.add(key, self.platform.store.read(key), content.sha256), ""
        except (ObjectMissingError, SourceDamagedError) as error:
            return None, str(error)

    def _keep(self, file: KeptFile) -> None:
        self.files.append(file)
        self._count(file.content)

    def _count(self, content: Content) -> None:
        self.brought += 1
        self.brought_bytes += content.size_bytes


def take(platform: Platform, folder: BackupFolder) -> Taken:
    """Back up database, store and uploads as of now.

    Raises `BackupBusyError`, `SchemaNotCurrentError`, `HoldLostError`, `StoreAwayError`, `OSError`.
    """
    haul = _Haul(platform, folder)
    with folder.writing(), collection_held(platform.database, "backup") as hold, folder.new_snapshot() as place:
        made_ns = now_ns()
        tables, named = _frozen(platform, place)
        haul.bring_blobs(dumped_rows(place, _named(tables, Blob), ("sha256", "object_key", "size_bytes")))
        haul.bring_slabs(dumped_rows(place, _named(tables, UploadSlab), ("object_key", "blob_sha256")))
        haul.bring_work(named.runs)
        for upload in named.uploads:
            haul.bring_upload(upload)
        snapshot = Snapshot(
            head_revision(),
            CODE_VERSION,
            made_ns,
            tables,
            write_files(place, tuple(haul.files)),
            tuple(haul.flaws),
            tuple(haul.given_up),
        )
        write_snapshot(place, snapshot)
        hold.check()
    return Taken(folder.snapshot(), snapshot, haul.blobs, haul.brought, haul.brought_bytes)


def _named(tables: tuple[TableFacts, ...], row: type[Base]) -> TableFacts:
    return next(table for table in tables if table.name == row.__tablename__)


def _frozen(platform: Platform, place: Path) -> tuple[tuple[TableFacts, ...], Named]:
    """The database as it is at this moment; the transaction is over before anything slow is copied."""
    with snapshot_of(platform.database) as connection:
        return dump(connection, place), named_by(connection)


def _few_ahead(
    pool: ThreadPoolExecutor,
    act: Callable[[tuple[Content, str]], tuple[Content | None, str]],
    items: Iterable[tuple[Content, str]],
) -> Iterator[tuple[Content | None, str]]:
    """What `act` answers, in order; never more than `AHEAD` of them under way, however many there are."""
    waiting = []
    for item in items:
        waiting.append(pool.submit(act, item))
        if len(waiting) >= AHEAD:
            yield waiting.pop(0).result()
    for outcome in waiting:
        yield outcome.result()
