"""Content-addressed blobs: bytes are stored first, then a row is added in the caller's transaction.

**Conventions.** The database decides, not a clock. An object without a blob has a row in `loose_objects`, committed
before its first byte is written. The process that deletes that row owns the object: `link` does so to create a blob,
and garbage collection (`services/runtime/store/garbage_collection.py`) condemns the row to delete the object. So in any
order of events, and with any grace, the object of a blob row exists. Content that is stored again gets a new key.

`adopt=True` promises that the file will not change any more, so it may share its bytes with the object. The file itself
always stays: delete it after the commit.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from secrets import token_hex
from threading import Event

import structlog
from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.database.transactions import Database
from services.runtime.orm import Blob, LooseObject
from services.runtime.orm.base import now_ns
from services.runtime.store.faults import fault_of, forget
from services.runtime.store.garbage_collection import BLOBS, GcResult, collect_garbage
from services.runtime.store.protocol import Store
from services.runtime.telemetry.counters import STORE_FAULTS, process_counters
from stone_files.bag_fingerprint import stream_sha256

__all__ = [
    "GcResult",
    "PreparedBlob",
    "collect_garbage",
    "hashed_beside",
    "keep",
    "link",
    "link_all",
    "prepare",
    "prepare_all",
    "prepare_hashed",
]

SLOW_BYTES_PER_S = 2**20
HASHERS = 4

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class PreparedBlob:
    """A file whose content is stored under `object_key`; the key is empty if a blob had the content already."""

    store: Store
    path: Path
    is_adopted: bool
    sha256: str
    size_bytes: int
    object_key: str = ""


def keep(session: Session, store: Store, path: Path, *, adopt: bool = False) -> Blob:
    """Store the content of `path` within the session's transaction and return its blob: for small files.

    For large files call `prepare` before the transaction and `link` inside it.
    """
    prepared = _hash(store, path, adopt)
    if _mend(prepared, _object_keys(session, [prepared])):
        forget(session, [prepared.sha256])
    return link(session, prepared)


def prepare(store: Store, database: Database, path: Path, *, adopt: bool = False) -> PreparedBlob:
    """Hash `path` and store its content unless a blob has it; call it outside transactions, then `link`.

    If a blob has the content, its object is read and compared. A missing or different object, which the platform itself
    never causes, is replaced.

    Unlinked content is collected after the grace. Raises `StoreFullError`, `store_unavailable`.
    """
    (prepared,) = prepare_all(store, database, [path], adopt=adopt)
    return prepared


def prepare_all(
    store: Store, database: Database, paths: Iterable[Path], *, adopt: bool = False
) -> Iterator[PreparedBlob]:
    """Prepare several files: hash a few at once, register them together, then store them one after another."""
    with hashed_beside(store, paths, adopt=adopt) as hashed:
        prepared = hashed()
    yield from prepare_hashed(database, prepared)


@contextmanager
def hashed_beside(
    store: Store, paths: Iterable[Path], *, adopt: bool = False
) -> Iterator[Callable[[], list[PreparedBlob]]]:
    """Hash files in threads for `prepare_hashed`, beside the block; the yielded function waits for the hashes.

    If the block ends without a call of this function, hashing stops.
    """
    given_up = Event()
    with ThreadPoolExecutor(HASHERS) as pool:
        coming = [pool.submit(_hash, store, path, adopt, given_up.is_set) for path in paths]
        try:
            yield lambda: [future.result() for future in coming]
        finally:
            given_up.set()


def prepare_hashed(database: Database, hashed: Sequence[PreparedBlob]) -> Iterator[PreparedBlob]:
    """Prepare files that `hashed_beside` has hashed, as `prepare_all` does."""
    with database.reading() as session:
        standing = _object_keys(session, hashed)
    fresh = [blob if blob.sha256 in standing else replace(blob, object_key=_fresh_key(blob.sha256)) for blob in hashed]
    _make_known(database, [blob for blob in fresh if blob.object_key])
    for blob in fresh:
        if blob.object_key:
            _store(blob, blob.object_key)
        elif _mend(blob, standing):
            with database.transaction() as session:
                forget(session, [blob.sha256])
        yield blob


def link(session: Session, prepared: PreparedBlob) -> Blob:
    """Return the blob's row, locked against garbage collection until the session ends: refer to it by a foreign key.

    If its object was collected meanwhile (after the grace), store the file again within the session. For several files
    use `link_all`: several calls of `link` in two sessions could deadlock.
    """
    return link_all(session, [prepared])[prepared.sha256]


def link_all(session: Session, prepared: Iterable[PreparedBlob]) -> dict[str, Blob]:
    """Return the rows of several contents by sha256, locked in an order that avoids deadlocks."""
    wanted = {blob.sha256: blob for blob in sorted(prepared, key=lambda blob: blob.sha256)}
    keys = _take_keys(session, [blob.object_key for blob in wanted.values() if blob.object_key])
    ours = {sha256: blob.object_key for sha256, blob in wanted.items() if blob.object_key in keys}
    blobs = _held(session, wanted)
    while missing := [blob for sha256, blob in wanted.items() if sha256 not in blobs]:
        for blob in missing:
            if blob.sha256 not in ours:
                ours[blob.sha256] = _store_within(session, blob)
        facts = [
            {"sha256": blob.sha256, "object_key": ours[blob.sha256], "size_bytes": blob.size_bytes} for blob in missing
        ]
        insert_new(session, Blob, facts)
        blobs |= _held(session, [blob.sha256 for blob in missing])
    # Another process stored the same content first:
    doubled = [key for sha256, key in ours.items() if key and blobs[sha256].object_key != key]
    insert_new(session, LooseObject, [{"object_key": key, "is_condemned": True} for key in doubled])
    return blobs


def _make_known(database: Database, fresh: Sequence[PreparedBlob]) -> None:
    """Register loose objects of contents that will be stored in this order, with ascending deadlines."""
    if not fresh:
        return
    bytes_until = accumulate(blob.size_bytes for blob in fresh)
    begun_ns = now_ns()
    expected = [begun_ns + until * 10**9 // SLOW_BYTES_PER_S for until in bytes_until]
    rows = [{"object_key": blob.object_key, "expected_ns": at} for blob, at in zip(fresh, expected, strict=True)]
    with database.transaction() as session:
        insert_new(session, LooseObject, rows)


def _take_keys(session: Session, keys: Sequence[str]) -> set[str]:
    """Take these keys out of `loose_objects`; return the keys taken: garbage collection condemned the others."""
    if not keys:
        return set()
    loose = delete(LooseObject).where(LooseObject.object_key.in_(keys), LooseObject.is_condemned.is_(False))
    return set(session.scalars(loose.returning(LooseObject.object_key)))


def _held(session: Session, sha256s: Iterable[str]) -> dict[str, Blob]:
    held = select(Blob).where(Blob.sha256.in_(list(sha256s))).order_by(Blob.sha256)
    return {blob.sha256: blob for blob in session.scalars(held.with_for_update(read=True, key_share=True))}


def _object_keys(session: Session, prepared: Iterable[PreparedBlob]) -> dict[str, str]:
    """Return the object key of each content that a blob has, by sha256."""
    statement = select(Blob.sha256, Blob.object_key).where(Blob.sha256.in_([blob.sha256 for blob in prepared]))
    return {sha256: key for sha256, key in session.execute(statement)}


def _store_within(session: Session, prepared: PreparedBlob) -> str:
    """Store under a key whose row is uncommitted; garbage collection waits for our commit to judge the object."""
    key = _fresh_key(prepared.sha256)
    insert_new(session, LooseObject, [{"object_key": key}])
    _store(prepared, key)
    return next(iter(_take_keys(session, [key])), "")


def _hash(store: Store, path: Path, adopt: bool, is_given_up: Callable[[], bool] = lambda: False) -> PreparedBlob:
    with path.open("rb", buffering=0) as file:
        sha256 = stream_sha256(file, is_given_up)
        return PreparedBlob(store, path, adopt, sha256, file.tell())


def _store(prepared: PreparedBlob, key: str) -> None:
    store = prepared.store.adopt if prepared.is_adopted else prepared.store.write
    store(key, prepared.path)


def _mend(prepared: PreparedBlob, standing: Mapping[str, str]) -> bool:
    """Replace the object of a content that a blob has (`standing`: its object by sha256) if it is damaged.

    If garbage collection takes the blob at the same time, it later deletes the object as one without a row.
    """
    if (key := standing.get(prepared.sha256)) is None:
        return False
    if not (fault := fault_of(prepared.store, replace(prepared, object_key=key), is_read=True)):
        return False
    log.error("damaged object replaced by the same content", object_key=key, fault=fault)
    process_counters().add(STORE_FAULTS, ("arrival",))
    prepared.store.write(key, prepared.path)
    return True


def _fresh_key(sha256: str) -> str:
    return f"{BLOBS}{sha256[:2]}/{sha256}.{token_hex(4)}"
