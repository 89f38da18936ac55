"""Garbage collection of the store: unreferenced blobs, unknown objects, work files of ended runs.

**Conventions.** A blob's row is deleted before its object, in the transaction that condemns the object. After a crash
at any point, the next run completes the deletion. The grace only saves work: the process that deletes the row of
`loose_objects` decides what may be deleted (`services/runtime/store/blobs.py`). While there is a hold
(`services/runtime/store/gc_holds.py`), rows are deleted and objects stay.
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, islice

from sqlalchemy import ColumnElement, and_, delete, exists, or_, select, union_all, update
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.jobs.changes import rows_changed
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Base, Blob, Job, LooseObject, UploadPartRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.gc_holds import GcCursor, is_gc_held, whole_cursor
from services.runtime.store.protocol import StoredObject
from services.runtime.store.workspace import Workspace

BLOBS = "blobs/"
UPLOADS = "uploads/"
WORK = "work/"
BATCH = 500
SLOWEST_WRITE_S = 86_400.0
NAMING = (Blob.object_key, UploadPartRow.object_key)
"""Columns that name a needed object."""
UNSYNCHRONISED = {"synchronize_session": False}
KEPT_FAILED_NS = 7 * 86_400 * 10**9


@dataclass(frozen=True)
class GcResult:
    """Numbers of deleted blob rows and objects (blobs, work files, leftovers of dead writers)."""

    rows: int
    objects: int


def collect_garbage(platform: Platform, turn: GcCursor | None = None) -> GcResult:
    """Delete everything older than the grace and unreferenced. Several processes may run it at once.

    With a `turn`, work for its share of time, continuing at the end of the last turn.
    """
    before_ns = now_ns() - int(platform.settings.store.grace_s * 1e9)
    blobs = BLOBS if turn is None else turn.next_shard(BLOBS)
    turn = turn or whole_cursor()
    rows = _release_blobs(platform, before_ns, turn)
    _condemn_loose(platform, before_ns, turn.until_s())
    _condemn_unknown(platform, before_ns, platform.store.listed(blobs))
    _condemn_unknown(platform, before_ns, turn.of_uploads.turn(platform.store.listed(UPLOADS), turn.listed))
    objects = _delete_condemned(platform, turn.deleting_s) + _delete_work(platform, before_ns, turn)
    return GcResult(rows, objects + platform.store.tidy(max(platform.settings.store.grace_s, SLOWEST_WRITE_S)))


def _release_blobs(platform: Platform, before_ns: int, turn: GcCursor) -> int:
    """Delete unreferenced rows, in slices of all blobs."""
    released, until_s = 0, turn.until_s()
    while True:
        ordered = select(Blob.sha256).where(Blob.sha256 > turn.after_sha256).order_by(Blob.sha256)
        with platform.database.reading() as session:
            last = session.scalar(ordered.offset(turn.slice_rows - 1).limit(1))
        slice_of = (Blob.sha256 > turn.after_sha256, *((Blob.sha256 <= last,) if last else ()))
        released += _release_among(platform, and_(Blob.created_ns <= before_ns, *slice_of))
        turn.after_sha256 = last or ""
        if last is None or time.monotonic() >= until_s:
            return released


def _release_among(platform: Platform, claim: ColumnElement[bool]) -> int:
    """Delete unreferenced rows, condemning their objects.

    PostgreSQL needs two statements: the first locks rows against new references, the second searches for references.
    """
    released = 0
    old = select(Blob.sha256).where(claim, ~_is_referenced())
    while True:
        with platform.database.transaction() as session:
            shas = session.scalars(old.limit(BATCH).with_for_update(skip_locked=True)).all()
            unneeded = delete(Blob).where(Blob.sha256.in_(shas), ~_is_referenced()).returning(Blob.object_key)
            keys = session.scalars(unneeded.execution_options(**UNSYNCHRONISED)).all()
            insert_new(session, LooseObject, [{"object_key": key, "is_condemned": True} for key in keys])
        released += len(keys)
        if len(shas) < BATCH:
            return released


def _is_referenced() -> ColumnElement[bool]:
    """Return whether a foreign key of any table refers to the blob."""
    columns = [column for table in Base.metadata.sorted_tables for column in table.columns]
    referring = [column for column in columns if any(key.column.table is Blob.__table__ for key in column.foreign_keys)]
    return or_(*(exists().where(column == Blob.sha256) for column in referring))


def _condemn_loose(platform: Platform, before_ns: int, until_s: float) -> None:
    """Condemn objects that were written and never linked."""
    is_forgotten = and_(LooseObject.is_condemned.is_(False), LooseObject.expected_ns <= before_ns)
    some = select(LooseObject.object_key).where(is_forgotten).limit(BATCH)
    forgotten = update(LooseObject).where(LooseObject.object_key.in_(some)).values(is_condemned=True)
    while True:
        with platform.database.transaction() as session:
            changed = rows_changed(session, forgotten)
        if changed < BATCH or time.monotonic() >= until_s:
            return


def _condemn_unknown(platform: Platform, before_ns: int, listed: Iterable[StoredObject]) -> None:
    """Condemn objects without a row: from transactions rolled back, or after a restore of an earlier database."""
    old = (stored for stored in listed if stored.modified_ns <= before_ns)
    while batch := [stored.key for stored in islice(old, BATCH)]:
        with platform.database.reading() as session:
            unknown = sorted(set(batch) - _find_known(session, batch))
        with platform.database.transaction() as session:
            condemned = insert_new(session, LooseObject, [{"object_key": key, "is_condemned": True} for key in unknown])
            _spare(session, condemned)


def _find_known(session: Session, keys: Sequence[str]) -> set[str]:
    """Return the keys that a row names. One statement is required, since a key may move from one table to another."""
    columns = (LooseObject.object_key, *NAMING)
    return set(session.scalars(union_all(*(select(column).where(column.in_(keys)) for column in columns))))


def _spare(session: Session, condemned: Sequence[str]) -> None:
    """Revoke the condemnation of objects named by a transaction that ours had to wait for."""
    named = union_all(*(select(column).where(column.in_(condemned)) for column in NAMING))
    session.execute(delete(LooseObject).where(LooseObject.object_key.in_(named)).execution_options(**UNSYNCHRONISED))


def _delete_condemned(platform: Platform, share_s: float) -> int:
    deleted, until_s = 0, time.monotonic() + share_s
    while True:
        with platform.database.reading() as session:
            condemned = select(LooseObject.object_key).where(LooseObject.is_condemned, ~is_gc_held())
            keys = session.scalars(condemned.limit(BATCH)).all()
        for key in keys:
            platform.store.delete(key)
        with platform.database.transaction() as session:
            gone = delete(LooseObject).where(LooseObject.object_key.in_(keys)).returning(LooseObject.object_key)
            deleted += len(session.scalars(gone.execution_options(**UNSYNCHRONISED)).all())
        if len(keys) < BATCH or time.monotonic() >= until_s:
            return deleted


def _delete_work(platform: Platform, before_ns: int, turn: GcCursor) -> int:
    """Delete the workspaces of ended runs; return the number of their objects."""
    deleted = 0
    for root_id, modified_ns in turn.of_work.turn(_list_workspaces(platform), turn.workspaces):
        if _is_over(platform, root_id, max(modified_ns) <= before_ns):
            Workspace(platform.store, platform.settings, root_id).remove()
            deleted += len(modified_ns)
    return deleted


def _list_workspaces(platform: Platform) -> Iterator[tuple[str, list[int]]]:
    """Yield each run with work files, and the times when these were written."""
    for root_id, objects in groupby(platform.store.listed(WORK), key=lambda stored: stored.key.split("/")[1]):
        yield root_id, [stored.modified_ns for stored in objects]


def _is_over(platform: Platform, root_id: str, is_old: bool) -> bool:
    """Return whether no job of the run will need its work again; for an unknown run, whether it is old."""
    statement = select(is_gc_held(), Job.state, Job.finished_ns).where(Job.id == root_id)
    with platform.database.reading() as session:
        known = session.execute(statement).one_or_none()
        if known is None:
            return is_old and not session.scalar(select(is_gc_held()))
    held, state, finished_ns = known
    is_forgotten = finished_ns is not None and finished_ns <= now_ns() - KEPT_FAILED_NS
    return not held and (state == "succeeded" or (state in TERMINAL and is_forgotten))
