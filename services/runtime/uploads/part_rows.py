"""Upload part rows: appended by compare-and-set, shared between equal uploads, released to garbage collection.

**Conventions.** The process that takes an object's row out of `loose_objects` owns the object
(`services/runtime/store/blobs.py`); that row is committed before the first byte is stored. Parts are only added, so
counted bytes stay until the upload ends. To add parts, a process locks the upload's row. If two add at the same offset,
the second receives `offset_mismatch`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.orm import Blob, LooseObject, Upload, UploadPartRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.rows import MOST, WHOLE, expiry_ns, kept_blob, refuse_gone, uploads_like
from stone.errors import Refused

SLOW_BYTES_PER_S = 2**20
BATCH = 500
STORE = "store"


@dataclass(frozen=True)
class UploadPart:
    """The bytes [offset, offset + length) of an upload, in the object `key`, which may be a blob's object."""

    key: str
    offset_bytes: int
    length_bytes: int
    blob_sha256: str | None = None

    @property
    def end_bytes(self) -> int:
        return self.offset_bytes + self.length_bytes


def upload_parts_of(session: Session, upload_id: str) -> list[UploadPart]:
    """Return the parts of an upload in the order of their bytes."""
    rows = session.scalars(
        select(UploadPartRow).where(UploadPartRow.upload_id == upload_id).order_by(UploadPartRow.offset_bytes)
    )
    return [UploadPart(row.object_key, row.offset_bytes, row.length_bytes, row.blob_sha256) for row in rows]


def end_of(session: Session, upload_id: str) -> int:
    """Return the number of bytes in the parts."""
    ends = select(UploadPartRow.offset_bytes + UploadPartRow.length_bytes).where(UploadPartRow.upload_id == upload_id)
    return session.scalar(ends.order_by(UploadPartRow.offset_bytes.desc()).limit(1)) or 0


def count_of(session: Session, upload_id: str) -> int:
    return session.scalar(select(func.count()).where(UploadPartRow.upload_id == upload_id)) or 0


def announce(platform: Platform, key: str, expected_bytes: int) -> None:
    """Announce an object before it is stored; its deadline allows `expected_bytes` over a slow connection."""
    expected_ns = now_ns() + expected_bytes * 10**9 // SLOW_BYTES_PER_S
    with platform.database.transaction() as session:
        session.add(LooseObject(object_key=key, expected_ns=expected_ns))


def add(platform: Platform, upload_id: str, parts: Sequence[UploadPart]) -> None:
    """Add all of the parts to the upload, or none. An upload that receives bytes does not expire.

    Raises `upload_gone`, or `offset_mismatch` if another process was first or the objects were collected.
    """
    first = parts[0].offset_bytes
    with platform.database.transaction() as session:
        upload = session.get_one(Upload, upload_id, with_for_update={"key_share": True})
        if upload.state != "open":  # an overdue upload that receives bytes continues
            refuse_gone(upload)
        end = upload.length_bytes if upload.state in WHOLE else end_of(session, upload_id)
        if end != first or not _take_objects(session, [part.key for part in parts]):
            raise Refused("offset_mismatch", f"the server has {end} bytes, not {first}; resume from byte {end}")
        session.add_all(_row(upload_id, part) for part in parts)
        if upload.expires_ns - now_ns() < platform.settings.uploads.expires_s * 5e8:
            upload.expires_ns = expiry_ns(platform)


def give_up(platform: Platform, keys: Sequence[str]) -> None:
    """Release objects that were announced and never added to garbage collection."""
    for batch in _batches(keys):
        with platform.database.transaction() as session:
            session.execute(update(LooseObject).where(LooseObject.object_key.in_(batch)).values(is_condemned=True))


def forget(platform: Platform, upload_id: str) -> None:
    """Delete the upload's parts; release objects without another user to garbage collection."""
    with platform.database.transaction() as session:
        session.get(Upload, upload_id, with_for_update={"key_share": True})
        gone = delete(UploadPartRow).where(UploadPartRow.upload_id == upload_id, UploadPartRow.blob_sha256.is_(None))
        keys = session.scalars(gone.returning(UploadPartRow.object_key)).all()
        session.execute(delete(UploadPartRow).where(UploadPartRow.upload_id == upload_id))
        for batch in _batches(keys):
            shared = set(session.scalars(select(UploadPartRow.object_key).where(UploadPartRow.object_key.in_(batch))))
            insert_new(
                session, LooseObject, [{"object_key": key, "is_condemned": True} for key in batch if key not in shared]
            )


def join(session: Session, whole_id: str, lengths: Sequence[tuple[str, int]]) -> None:
    """Give an upload the bytes of others, in this order; `lengths` contains the id and the length of each."""
    start = 0
    for part_id, length_bytes in lengths:
        moved = update(UploadPartRow).where(UploadPartRow.upload_id == part_id)
        offset = UploadPartRow.offset_bytes + start
        session.execute(
            moved.values(upload_id=whole_id, offset_bytes=offset), execution_options={"synchronize_session": False}
        )
        start += length_bytes


def share(session: Session, upload: Upload) -> bool:
    """Share the owner's existing bytes with a new upload; return False if there are none.

    It does not wait for uploads that another process is ending: the client sends the bytes again.
    """
    if not upload.declared_sha256:
        return False
    twins = uploads_like(upload).where(Upload.backend == STORE, Upload.id != upload.id).order_by(Upload.id.desc())
    for duplicate_id in session.scalars(twins.limit(MOST).with_for_update(read=True, skip_locked=True)).all():
        parts = upload_parts_of(session, duplicate_id)
        if parts and parts[-1].end_bytes == upload.length_bytes:
            session.add_all(_row(upload.id, part) for part in parts)
            return True
    kept = kept_blob(session, upload)
    if kept is None:
        return False
    held = select(Blob).where(Blob.sha256 == kept.sha256).with_for_update(read=True, key_share=True, skip_locked=True)
    if (blob := session.scalar(held)) is not None:
        session.add(_row(upload.id, UploadPart(blob.object_key, 0, blob.size_bytes, blob.sha256)))
    return blob is not None


def _row(upload_id: str, part: UploadPart) -> UploadPartRow:
    row = UploadPartRow(upload_id=upload_id, offset_bytes=part.offset_bytes, length_bytes=part.length_bytes)
    row.object_key, row.blob_sha256 = part.key, part.blob_sha256
    return row


def _take_objects(session: Session, keys: Sequence[str]) -> bool:
    """Take all objects; return False if garbage collection condemned any of them."""
    taken = 0
    for batch in _batches(keys):
        ours = delete(LooseObject).where(LooseObject.object_key.in_(batch), LooseObject.is_condemned.is_(False))
        taken += len(session.scalars(ours.returning(LooseObject.object_key)).all())
    return taken == len(keys)


def _batches(keys: Sequence[str]) -> Iterator[list[str]]:
    left = iter(keys)
    while batch := list(islice(left, BATCH)):
        yield batch
