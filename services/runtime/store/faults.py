"""Objects that differ from their blob's row: detected, recorded, and forgotten once they are sound.

**Conventions.** The row counts: `sha256` and `size_bytes` define the object. A fault is a row itself, so every process
shows the same faults. `served` means that the bytes differed while a request or a job read them. The scrub
(`services/maintenance/scrub.py`) reads such an object next, and records its fault or deletes the row.
"""

import errno
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import file_digest, sha256
from typing import Protocol

import structlog
from sqlalchemy import delete, exists, func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.database.transactions import Database
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Base, Blob, StoreFault, StoreScrub
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.protocol import Store
from services.runtime.telemetry.counters import STORE_FAULTS, process_counters
from stone.errors import PlatformFaultError, StoneError

UNREADABLE = {errno.EIO, errno.EBADMSG, errno.EUCLEAN}
"""Errors of a disk that lost the bytes, and of a file system whose own checksums differ."""
MISSING, SIZE, BYTES, SERVED = "missing", "size", "bytes", "served"
MOST_SHOWN = 200

log = structlog.get_logger(__name__)


class BlobFacts(Protocol):
    """The facts about an object in its blob's row."""

    @property
    def sha256(self) -> str: ...
    @property
    def object_key(self) -> str: ...
    @property
    def size_bytes(self) -> int: ...


@dataclass(frozen=True)
class ScrubStatus:
    """Progress of the scrub: objects and bytes of the pass that started at `begun_ns`; null before the first."""

    passed_ns: int | None
    begun_ns: int | None
    objects: int
    size_bytes: int
    faults: int


@dataclass(frozen=True)
class NotedFault:
    """A recorded fault; `named_by` are the tables whose rows need the object."""

    sha256: str
    object_key: str
    size_bytes: int
    fault: str
    found_ns: int
    named_by: tuple[str, ...]


def fault_of(store: Store, blob: BlobFacts, *, is_read: bool = False) -> str:
    """Return the fault of the blob's object: `missing`, `size`, `bytes` or none; `bytes` only if all of it is read.

    Raises `store_unavailable`.
    """
    try:
        if store.size_bytes(blob.object_key) != blob.size_bytes:
            return SIZE
        return BYTES if is_read and sha256_of(store.read(blob.object_key)) != blob.sha256 else ""
    except ObjectMissingError:
        return MISSING
    except OSError as error:
        if error.errno not in UNREADABLE:
            raise
        return BYTES


def sha256_of(pieces: Iterable[bytes]) -> str:
    digest = sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()


def note(session: Session, found: BlobFacts, fault: str, by: str) -> None:
    """Record the object's fault, unless it is recorded already; `by` names its finder to the counter."""
    known = session.get(StoreFault, found.sha256, populate_existing=True)
    if known is not None and known.fault == fault:
        return
    log.error("object damaged", object_key=found.object_key, sha256=found.sha256, fault=fault, found_by=by)
    process_counters().add(STORE_FAULTS, (by,))
    forget(session, [found.sha256])
    insert_new(session, StoreFault, [{"sha256": found.sha256, "fault": fault}])


def note_served(database: Database, object_keys: Sequence[str]) -> None:
    """Record that bytes of one of these objects differed when read; log it if the database is unavailable."""
    log.error("bytes differ from their sha256", object_keys=list(object_keys)[:MOST_SHOWN])
    process_counters().add(STORE_FAULTS, (SERVED,))
    try:
        with database.transaction() as session:
            hashes = session.scalars(select(Blob.sha256).where(Blob.object_key.in_(object_keys))).all()
            insert_new(session, StoreFault, [{"sha256": sha, "fault": SERVED} for sha in sorted(hashes)])
    except SQLAlchemyError as error:
        log.warning("fault not noted; the scrub will find it", reason=f"{type(error).__name__}: {error}"[:500])


def refuse_damaged(store: Store, database: Database, object_keys: Iterable[str], named: str) -> None:
    """Raise `ObjectDamagedError` if this machine reads other bytes than were stored for one of these blobs.

    Call it before refusing a user's input. It reads all bytes, drops a different copy, and records a fault.
    """
    with database.reading() as session:
        blobs = session.scalars(select(Blob).where(Blob.object_key.in_(list(object_keys)))).all()
    for blob in blobs:
        if _is_sound_here(store, blob):
            continue
        store.forget_copy(blob.object_key)
        if fault := fault_of(store, blob, is_read=True):
            with database.transaction() as session:
                note(session, blob, fault, "judged")
        raise ObjectDamagedError(named, (blob.object_key,))


@contextmanager
def comparing(store: Store, database: Database, object_keys: Iterable[str], named: str) -> Iterator[None]:
    """Read these objects in the block; raise `ObjectDamagedError` instead of a refusal that a damaged object caused."""
    try:
        yield
    except StoneError as error:
        if not isinstance(error, PlatformFaultError | JobCancelledError):
            refuse_damaged(store, database, object_keys, named)
        raise


def _is_sound_here(store: Store, blob: BlobFacts) -> bool:
    try:
        with store.local(blob.object_key).open("rb") as file:
            return file_digest(file, "sha256").hexdigest() == blob.sha256
    except ObjectMissingError:
        return False
    except OSError as error:
        if error.errno not in UNREADABLE:
            raise
        return False


def forget(session: Session, sha256s: Iterable[str]) -> None:
    """Delete the faults of these objects, which are sound."""
    session.execute(delete(StoreFault).where(StoreFault.sha256.in_(list(sha256s))))


def scrub_status(session: Session) -> ScrubStatus:
    """Return the progress of the scrub, and the number of faults."""
    row, faults = session.get(StoreScrub, 1), count_of_faults(session)
    if row is None:
        return ScrubStatus(None, None, 0, 0, faults)
    return ScrubStatus(row.passed_ns, row.begun_ns, row.objects, row.size_bytes, faults)


def count_of_faults(session: Session) -> int:
    """Return the number of faults whose blob still exists."""
    standing = select(func.count()).select_from(StoreFault).join(Blob, Blob.sha256 == StoreFault.sha256)
    return session.scalar(standing) or 0


def noted_faults(session: Session, most: int = MOST_SHOWN) -> list[NotedFault]:
    """Return the faults whose blob still exists, the oldest first."""
    standing = select(Blob, StoreFault).join(StoreFault, StoreFault.sha256 == Blob.sha256)
    rows = session.execute(standing.order_by(StoreFault.found_ns, StoreFault.sha256).limit(most)).all()
    return [
        NotedFault(
            *(blob.sha256, blob.object_key, blob.size_bytes, row.fault, row.found_ns),
            tuple(tables_naming(session, blob.sha256)),
        )
        for blob, row in rows
    ]


def tables_naming(session: Session, sha256_: str) -> Iterator[str]:
    """Yield the tables with a row that needs the blob."""
    for table in Base.metadata.sorted_tables:
        keys = [
            column for column in table.columns if any(key.column.table is Blob.__table__ for key in column.foreign_keys)
        ]
        if any(session.scalar(select(exists().where(column == sha256_))) for column in keys):
            yield table.name


class ObjectDamagedError(PlatformFaultError):
    """Bytes of one of these objects differ from the stored bytes; the error's handler records it (`note_served`)."""

    def __init__(self, named: str, object_keys: Sequence[str]) -> None:
        super().__init__(
            "object_damaged",
            f"{named} is damaged in the store. This is a fault of the platform, which its operator can see. "
            "Try again later, or if it is your file, upload it again to repair it",
        )
        self.object_keys = tuple(object_keys)
