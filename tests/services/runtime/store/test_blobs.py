"""Blobs: each content once, and a collection that never takes what a row names, however it races with writers."""

import hashlib
import random
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from io import FileIO
from pathlib import Path

import pytest
from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from services.runtime.orm import Blob, CalibrationRow, Job, LooseObject
from services.runtime.orm.base import new_id, now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.store.blobs import (
    GcResult,
    PreparedBlob,
    collect_garbage,
    hashed_beside,
    keep,
    link,
    prepare,
    prepare_all,
)
from services.runtime.store.protocol import Store
from stone_files import bag_fingerprint
from tests.services.runtime.jobs.steps import act
from tests.services.runtime.store.conftest import in_bucket
from tests.services.runtime.uploads.sending import make_owner

DAY_NS = 86_400 * 10**9
RACES = 8
PATIENCE_S = 300.0


@pytest.fixture
def owner_id(platform: Platform) -> str:
    return make_owner(platform).user_id


def file_of(folder: Path, content: bytes) -> Path:
    path = folder / hashlib.sha256(content).hexdigest()[:8]
    path.write_bytes(content)
    return path


def refer(session: Session, blob: Blob, owner_id: str) -> CalibrationRow:
    """A row that needs the blob."""
    id = new_id()
    row = CalibrationRow(id=id, owner_id=owner_id, name=id, version=1, filename="c.yaml", sha256=blob.sha256)
    row.blob_sha256, row.sensors, row.findings = blob.sha256, [], []
    session.add(row)
    session.flush()
    return row


def keep_for(platform: Platform, owner_id: str, path: Path) -> Blob:
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, path)
        refer(session, blob, owner_id)
    return blob


def keys_of(store: Store) -> list[str]:
    return [found.key for found in store.listed("")]


def rows_of(platform: Platform, row: type[Blob] | type[LooseObject]) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(row)) or 0


def test_a_content_is_stored_once_under_its_sha256(anywhere: Platform, owner_id: str, tmp_path: Path) -> None:
    sha256 = hashlib.sha256(b"content").hexdigest()
    first = keep_for(anywhere, owner_id, file_of(tmp_path, b"content"))
    again = keep_for(anywhere, owner_id, file_of(tmp_path, b"content"))
    assert (first.sha256, first.size_bytes, again.object_key) == (sha256, 7, first.object_key)
    assert first.object_key.startswith(f"blobs/{sha256[:2]}/{sha256}.")
    assert keys_of(anywhere.store) == [first.object_key]
    assert rows_of(anywhere, LooseObject) == 0
    assert b"".join(anywhere.store.read(first.object_key)) == b"content"


def test_bytes_are_stored_before_the_transaction_and_named_in_it(
    hasty: Platform, owner_id: str, tmp_path: Path
) -> None:
    prepared = prepare(hasty.store, hasty.database, file_of(tmp_path, b"content"))
    assert keys_of(hasty.store) == [prepared.object_key]
    assert (rows_of(hasty, Blob), rows_of(hasty, LooseObject)) == (0, 1)
    with hasty.database.transaction() as session:
        blob = link(session, prepared)
        refer(session, blob, owner_id)
    assert blob.object_key == prepared.object_key
    assert (rows_of(hasty, Blob), rows_of(hasty, LooseObject)) == (1, 0)


def test_an_adopted_file_outlives_a_transaction_that_fails(hasty: Platform, owner_id: str, tmp_path: Path) -> None:
    path = file_of(tmp_path, b"content")
    with suppress(ZeroDivisionError), hasty.database.transaction() as session:
        keep(session, hasty.store, path, adopt=True)
        raise ZeroDivisionError
    assert path.read_bytes() == b"content"
    assert collect_garbage(hasty) == GcResult(0, 1)
    with hasty.database.transaction() as session:
        blob = keep(session, hasty.store, path, adopt=True)
        refer(session, blob, owner_id)
    path.unlink()
    assert b"".join(hasty.store.read(blob.object_key)) == b"content"


def test_of_two_that_prepared_one_content_one_is_kept_and_the_other_collected(
    hasty: Platform, owner_id: str, tmp_path: Path
) -> None:
    one, other = (prepare(hasty.store, hasty.database, file_of(tmp_path, b"content")) for _ in range(2))
    for prepared in (one, other):
        with hasty.database.transaction() as session:
            blob = link(session, prepared)
            refer(session, blob, owner_id)
    assert sorted(keys_of(hasty.store)) == sorted([one.object_key, other.object_key])
    assert collect_garbage(hasty) == GcResult(0, 1)
    assert keys_of(hasty.store) == [blob.object_key] == [one.object_key]


def test_what_nothing_refers_to_is_collected_row_and_object(anywhere: Platform, owner_id: str, tmp_path: Path) -> None:
    kept = keep_for(anywhere, owner_id, file_of(tmp_path, b"needed"))
    act(anywhere, keep, anywhere.store, file_of(tmp_path, b"forgotten"))
    prepare(anywhere.store, anywhere.database, file_of(tmp_path, b"never linked"))
    anywhere.store.write("blobs/00/unknown", file_of(tmp_path, b"of a database that was restored"))
    assert collect_garbage(anywhere) == GcResult(rows=1, objects=3)
    assert keys_of(anywhere.store) == [kept.object_key]
    assert (rows_of(anywhere, Blob), rows_of(anywhere, LooseObject)) == (1, 0)
    assert collect_garbage(anywhere) == GcResult(0, 0)


def test_a_blob_is_collected_when_its_last_reference_is_gone(hasty: Platform, owner_id: str, tmp_path: Path) -> None:
    path = file_of(tmp_path, b"content")
    with hasty.database.transaction() as session:
        blob = keep(session, hasty.store, path)
        rows = [refer(session, blob, owner_id), refer(session, blob, owner_id)]
    for row, left in zip(rows, (1, 0), strict=True):
        with hasty.database.transaction() as session:
            session.delete(session.merge(row))
        collect_garbage(hasty)
        assert len(keys_of(hasty.store)) == left


def test_within_the_grace_nothing_is_collected(platform: Platform, tmp_path: Path) -> None:
    act(platform, keep, platform.store, file_of(tmp_path, b"forgotten"))
    prepare(platform.store, platform.database, file_of(tmp_path, b"never linked"))
    platform.store.write("blobs/00/unknown", file_of(tmp_path, b"x"))
    platform.store.write("work/unknown/file", file_of(tmp_path, b"x"))
    assert collect_garbage(platform) == GcResult(0, 0)
    assert len(keys_of(platform.store)) == 4


def test_what_was_collected_before_it_was_linked_is_stored_again(
    hasty: Platform, owner_id: str, tmp_path: Path
) -> None:
    prepared = prepare(hasty.store, hasty.database, file_of(tmp_path, b"content"))
    assert collect_garbage(hasty) == GcResult(0, 1)
    assert link_and_read(hasty, prepared, owner_id) == b"content"
    collect_garbage(hasty)
    assert len(keys_of(hasty.store)) == 1


def test_what_was_kept_when_prepared_and_collected_before_it_was_linked_is_stored_again(
    hasty: Platform, owner_id: str, tmp_path: Path
) -> None:
    act(hasty, keep, hasty.store, file_of(tmp_path, b"content"))
    prepared = prepare(hasty.store, hasty.database, file_of(tmp_path, b"content"))
    assert collect_garbage(hasty) == GcResult(1, 1)
    assert link_and_read(hasty, prepared, owner_id) == b"content"


def link_and_read(platform: Platform, prepared: PreparedBlob, owner_id: str) -> bytes:
    with platform.database.transaction() as session:
        blob = link(session, prepared)
        refer(session, blob, owner_id)
    return b"".join(platform.store.read(blob.object_key))


def test_a_collection_that_the_store_interrupted_is_ended_by_the_next(
    hasty: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    act(hasty, keep, hasty.store, file_of(tmp_path, b"forgotten"))

    def away(key: str) -> None:
        raise ConnectionError(key)

    with monkeypatch.context() as patched:
        patched.setattr(hasty.store, "delete", away)
        with pytest.raises(ConnectionError, match="blobs/"):
            collect_garbage(hasty)
    assert (rows_of(hasty, Blob), rows_of(hasty, LooseObject)) == (0, 1)
    assert collect_garbage(hasty) == GcResult(0, 1)
    assert (rows_of(hasty, LooseObject), keys_of(hasty.store)) == (0, [])


def test_a_clock_set_back_or_forth_takes_nothing_that_a_row_names(
    platform: Platform, owner_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = keep_for(platform, owner_id, file_of(tmp_path, b"needed"))
    prepared = prepare(platform.store, platform.database, file_of(tmp_path, b"under way"))
    for shift_ns in (-400 * DAY_NS, 400 * DAY_NS):
        monkeypatch.setattr(
            "services.runtime.store.garbage_collection.now_ns", lambda shift_ns=shift_ns: time.time_ns() + shift_ns
        )
        collect_garbage(platform)
    assert b"".join(platform.store.read(kept.object_key)) == b"needed"
    assert link_and_read(platform, prepared, owner_id) == b"under way"


@pytest.mark.parametrize(
    ("state", "ended_ns", "stays"),
    [
        ("running", None, True),
        ("queued", None, True),
        ("failed", -6 * DAY_NS, True),
        ("cancelled", -6 * DAY_NS, True),
        ("failed", -8 * DAY_NS, False),
        ("cancelled", -8 * DAY_NS, False),
        ("succeeded", -1, False),
    ],
)
def test_the_work_of_a_run_stays_while_somebody_may_ask_for_it(
    hasty: Platform, owner_id: str, tmp_path: Path, state: str, ended_ns: int | None, stays: bool
) -> None:
    id = new_id()
    finished_ns = None if ended_ns is None else now_ns() + ended_ns
    with hasty.database.transaction() as session:
        session.add(Job(id=id, root_id=id, owner_id=owner_id, kind="run", state=state, finished_ns=finished_ns))
    for name in ("a", "tiles/b"):
        hasty.store.write(f"work/{id}/{name}", file_of(tmp_path, b"x"))
    assert collect_garbage(hasty) == GcResult(0, 0 if stays else 2)
    assert len(keys_of(hasty.store)) == (2 if stays else 0)


@pytest.mark.whole
@pytest.mark.parametrize("store", ["folder", "s3"])
def test_a_row_s_object_exists_however_keeping_and_collecting_race(
    hasty_on: Platform, request: pytest.FixtureRequest, tmp_path: Path, store: str
) -> None:
    """Catches alone an object that is collected while it is being kept."""
    if store == "s3" and hasty_on.database.is_sqlite:
        pytest.skip("whoever has a bucket has PostgreSQL")
    at = in_bucket(request, hasty_on) if store == "s3" else hasty_on
    paths = [file_of(tmp_path, content) for content in (b"one", b"two")]
    owner_id = make_owner(at).user_id
    race(
        at,
        lambda: prepare_and_refer(at, owner_id, random.choice(paths)),
        lambda: keep_for(at, owner_id, random.choice(paths)),
    )


def prepare_and_refer(platform: Platform, owner_id: str, path: Path) -> None:
    prepared = prepare(platform.store, platform.database, path)
    with platform.database.transaction() as session:
        refer(session, link(session, prepared), owner_id)


def race(platform: Platform, *writers: Callable[[], object]) -> None:
    """Writers, one that takes references away, and collectors: at no moment is missing what a row names."""
    over, failures, collected = threading.Event(), list[BaseException](), list[int]()

    def again_and_again(act: Callable[[], object]) -> None:
        try:
            while not over.is_set():
                act()
        except BaseException as error:
            failures.append(error)
            over.set()

    def check_and_forget() -> None:
        with platform.database.transaction() as session:
            for blob in session.scalars(select(Blob).where(Blob.sha256.in_(select(CalibrationRow.blob_sha256)))):
                content = b"".join(platform.store.read(blob.object_key))
                assert hashlib.sha256(content).hexdigest() == blob.sha256
            session.execute(delete(CalibrationRow))

    acts = [*writers, check_and_forget, *[lambda: collected.append(collect_garbage(platform).rows)] * 2]
    threads = [threading.Thread(target=again_and_again, args=(act,)) for act in acts]
    for thread in threads:
        thread.start()
    deadline_s = time.monotonic() + PATIENCE_S
    while sum(collected) < RACES and not over.wait(0.05) and time.monotonic() < deadline_s:
        pass
    over.set()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]
    assert sum(collected) >= RACES, "collectors never met a blob to take: the race did not happen"
    check_and_forget()
    collect_garbage(platform)
    assert (rows_of(platform, Blob), rows_of(platform, LooseObject), keys_of(platform.store)) == (0, 0, [])


def test_several_files_are_hashed_at_once_and_stored_in_their_order(
    platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths, together, digest = [tmp_path / name for name in "bacd"], threading.Barrier(2), blobs.stream_sha256
    for path in paths:
        path.write_bytes(path.name.encode())

    def digest_together(file: FileIO, is_given_up: Callable[[], bool]) -> str:
        together.wait(timeout=20)
        return digest(file, is_given_up)

    monkeypatch.setattr(blobs, "stream_sha256", digest_together)
    stored = list(prepare_all(platform.store, platform.database, paths))
    assert [one.path for one in stored] == paths
    assert [one.sha256 for one in stored] == [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths]


def test_who_leaves_without_asking_does_not_wait_for_hashes(
    platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_fingerprint, "HASH_BLOCK_BYTES", 1)
    path = file_of(tmp_path, bytes(10**8))
    with hashed_beside(platform.store, [path]) as hashed:
        begun = time.monotonic()
    assert time.monotonic() - begun < PATIENCE_S / 10
    assert hashed()[0].size_bytes < 10**8
