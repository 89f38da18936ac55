"""Content-addressed blobs: bytes are stored first, then a row is added in the caller's transaction.

**Conventions.** The database is the arbiter, no clock is: an object that no blob names has a row in `loose_objects`,
committed before its first byte is written, and whoever takes that row out has the object. `link` takes it to make a
blob; garbage collection (`services/runtime/store/garbage_collection.py`) condemns it to delete the object. So whatever
the order of things and however short the grace, what a blob row names exists. A content stored again gets a new key.

`adopt=True` says that nobody will change the file any more, so that it may share its bytes with the object. The file
itself always stays: remove it after the commit.
"""

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex

import structlog
from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.database.transactions import Database
from services.runtime.orm import Blob, LooseObject
from services.runtime.orm.base import now_ns
from services.runtime.store.garbage_collection import BLOBS, GcResult, collect_garbage
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.protocol import Store

__all__ = ["GcResult", "PreparedBlob", "collect_garbage", "keep", "link", "link_all", "prepare"]

SLOW_BYTES_PER_S = 2**20

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class PreparedBlob:
    """A file whose content is stored under `object_key`, or was stored already (then the key is empty)."""

    store: Store
    path: Path
    is_adopted: bool
    sha256: str
    size_bytes: int
    object_key: str = ""


def keep(session: Session, store: Store, path: Path, *, adopt: bool = False) -> Blob:
    """The blob of the content of `path`, stored within the session's transaction: for small files.

    For large ones `prepare` before the transaction and `link` inside it.
    """
    prepared = _hashed(store, path, adopt)
    _mended(prepared, session)
    return link(session, prepared)


def prepare(store: Store, database: Database, path: Path, *, adopt: bool = False) -> PreparedBlob:
    """Hash `path` and store its content unless a blob has it; call it outside transactions, then `link`.

    Where a blob has it and its object is gone, which only others than us can have done, the object is put back.

    What is never linked is collected after the grace. Raises `StoreFullError`, `StoreAwayError`.
    """
    prepared = _hashed(store, path, adopt)
    with database.reading() as session:
        if _mended(prepared, session):
            return prepared
    key = _fresh_key(prepared.sha256)
    with database.transaction() as session:
        expected_ns = now_ns() + prepared.size_bytes * 10**9 // SLOW_BYTES_PER_S
        session.add(LooseObject(object_key=key, expected_ns=expected_ns))
    _store(prepared, key)
    return PreparedBlob(store, path, adopt, prepared.sha256, prepared.size_bytes, key)


def link(session: Session, prepared: PreparedBlob) -> Blob:
    """The blob's row, held against garbage collection until the session ends: refer to it by a foreign key before that.

    Where its object was collected meanwhile (the grace passed), the file is stored again, within the session. Whoever
    links several in one session does so by `link_all`, or two such sessions may wait for each other.
    """
    key = _taken(session, prepared.object_key)
    while (blob := _held(session, prepared.sha256)) is None:
        key = key or _stored_within(session, prepared)
        facts = {"sha256": prepared.sha256, "object_key": key, "size_bytes": prepared.size_bytes}
        insert_new(session, Blob, [facts])
    if key and blob.object_key != key:  # somebody else stored the same content first
        insert_new(session, LooseObject, [{"object_key": key, "is_condemned": True}])
    return blob


def link_all(session: Session, prepared: Iterable[PreparedBlob]) -> None:
    """The rows of several contents, in the one order in which no two sessions wait for each other."""
    by_content = {blob.sha256: blob for blob in prepared}
    for _sha256, blob in sorted(by_content.items()):
        link(session, blob)


def _taken(session: Session, key: str) -> str:
    """`key`, now ours alone, or nothing when garbage collection condemned it."""
    loose = delete(LooseObject).where(LooseObject.object_key == key, LooseObject.is_condemned.is_(False))
    return key if key and session.execute(loose.returning(LooseObject.object_key)).first() else ""


def _held(session: Session, sha256: str) -> Blob | None:
    return session.scalar(select(Blob).where(Blob.sha256 == sha256).with_for_update(read=True, key_share=True))


def _stored_within(session: Session, prepared: PreparedBlob) -> str:
    """Store under a key whose row nobody else sees; garbage collection waits for our commit to judge the object."""
    key = _fresh_key(prepared.sha256)
    insert_new(session, LooseObject, [{"object_key": key}])
    _store(prepared, key)
    return _taken(session, key)


def _hashed(store: Store, path: Path, adopt: bool) -> PreparedBlob:
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        return PreparedBlob(store, path, adopt, sha256, file.tell())


def _store(prepared: PreparedBlob, key: str) -> None:
    place = prepared.store.adopt if prepared.is_adopted else prepared.store.write
    place(key, prepared.path)


def _mended(prepared: PreparedBlob, session: Session) -> bool:
    """Whether a blob has the content; its object is stored again where it is gone.

    Should garbage collection take the blob meanwhile, it comes upon the object as one that no row speaks of.
    """
    key = session.scalar(select(Blob.object_key).where(Blob.sha256 == prepared.sha256))
    if key is None:
        return False
    with suppress(ObjectMissingError):
        if prepared.store.size_bytes(key) == prepared.size_bytes:
            return True
    log.warning("lost object put back", object_key=key)
    prepared.store.write(key, prepared.path)
    return True


def _fresh_key(sha256: str) -> str:
    return f"{BLOBS}{sha256[:2]}/{sha256}.{token_hex(4)}"
