"""Collections look at some of very many blobs each time, miss none in the end, and wait while they are held."""

from pathlib import Path

import pytest
from sqlalchemy import func, select, update

from services.runtime.orm import Blob, GcHoldRow, Job, LooseObject, User, new_id
from services.runtime.platform import Platform
from services.runtime.store import garbage_collection
from services.runtime.store.blobs import keep
from services.runtime.store.garbage_collection import BLOBS, UPLOADS, collect_garbage
from services.runtime.store.gc_holds import SHARDS, GcCursor, gc_hold, is_gc_held
from services.runtime.store.workspace import Workspace
from testing.refusals import refused_as
from tests.services.runtime.store.test_blobs import keys_of


def laid(platform: Platform, folder: Path, count: int) -> None:
    """So many blobs that nothing refers to."""
    for number in range(count):
        path = folder / f"{number}"
        path.write_text(f"nobody needs {number}")
        with platform.database.transaction() as session:
            keep(session, platform.store, path)


def left(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Blob)) or 0


def test_a_short_turn_looks_at_a_slice_and_goes_on_where_it_ended(hasty_on: Platform, tmp_path: Path) -> None:
    laid(hasty_on, tmp_path, 5)
    turn = GcCursor(share_s=0.0, slice_rows=2)
    assert [collect_garbage(hasty_on, turn).rows for _ in range(3)] == [2, 2, 1]
    assert turn.after_sha256 == "", "what comes next is looked at from the beginning"
    laid(hasty_on, tmp_path, 1)
    assert collect_garbage(hasty_on, turn).rows == 1


def test_a_turn_with_time_enough_looks_at_everything(hasty: Platform, tmp_path: Path) -> None:
    laid(hasty, tmp_path, 5)
    assert collect_garbage(hasty, GcCursor(share_s=60.0, slice_rows=2)).rows == 5
    assert left(hasty) == 0


def test_objects_no_row_speaks_of_are_found_when_their_turn_comes(hasty: Platform, tmp_path: Path) -> None:
    stray = tmp_path / "stray"
    stray.write_text("of a transaction that was rolled back")
    key = f"{BLOBS}02/{'02' * 32}.00000000"
    hasty.store.write(key, stray)
    turn = GcCursor()
    assert [collect_garbage(hasty, turn).objects for _ in range(3)] == [0, 0, 1]
    assert list(hasty.store.listed(BLOBS)) == []


def test_objects_under_way_that_no_row_speaks_of_are_found_some_a_turn(hasty: Platform, tmp_path: Path) -> None:
    stray = tmp_path / "stray"
    stray.write_text("of an upload that was rolled back")
    for number in range(3):
        hasty.store.write(f"{UPLOADS}{number:032x}/000000000000-{number:016x}", stray)
    turn = GcCursor(listed=2)
    assert [collect_garbage(hasty, turn).objects for _ in range(3)] == [2, 1, 0]


def test_workspaces_of_runs_that_are_over_are_removed_some_a_turn(hasty_on: Platform, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("of a run that nobody knows any more")
    for _ in range(3):
        hasty_on.store.write(f"work/{new_id()}/points", file)
    turn = GcCursor(workspaces=2)
    assert [collect_garbage(hasty_on, turn).objects for _ in range(3)] == [2, 1, 0]


def test_a_turn_without_time_deletes_a_batch(hasty: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garbage_collection, "BATCH", 2)
    laid(hasty, tmp_path, 5)
    turn = GcCursor(deleting_s=0.0)
    assert [collect_garbage(hasty, turn).objects for _ in range(3)] == [2, 2, 1]
    with hasty.database.transaction() as session:
        session.add_all(LooseObject(object_key=f"blobs/{number}", expected_ns=1) for number in range(5))
    turn.share_s = 0.0
    assert [collect_garbage(hasty, turn).objects for _ in range(3)] == [2, 2, 1]


def test_every_shard_has_its_turn() -> None:
    turn = GcCursor()
    assert {turn.next_shard(BLOBS) for _ in range(SHARDS)} == {f"blobs/{number:02x}/" for number in range(SHARDS)}
    assert turn.next_shard(BLOBS) == "blobs/00/"


def forgotten(platform: Platform, scratch: Path) -> list[str]:
    """A blob that nobody refers to and the work of a run that is over; the keys of both."""
    path = scratch / "file"
    path.write_bytes(b"content")
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, path)
        user = User(name="ada", role="curator")
        session.add(user)
        session.flush()
        run = Job(id=new_id(), owner_id=user.id, kind="sequence.process", state="succeeded")
        run.root_id = run.id
        session.add(run)
    workspace = Workspace(platform.store, platform.settings, run.id)
    (workspace.folder / "poses.bin").write_bytes(b"work")
    workspace.push("")
    return [blob.object_key, f"work/{run.id}/poses.bin"]


def test_what_nobody_needs_stays_while_held_and_goes_afterwards(hasty: Platform, tmp_path: Path) -> None:
    keys = forgotten(hasty, tmp_path)
    with gc_hold(hasty.database, "backup"):
        assert collect_garbage(hasty).objects == 0
        assert keys_of(hasty.store) == keys
    collect_garbage(hasty)
    assert keys_of(hasty.store) == []


def test_a_holder_that_died_holds_nothing_up_for_ever(hasty: Platform, tmp_path: Path) -> None:
    forgotten(hasty, tmp_path)
    with gc_hold(hasty.database, "backup") as hold:
        with hasty.database.transaction() as session:
            session.execute(update(GcHoldRow).values(until_ns=1))
            assert session.scalar(select(is_gc_held())) is False
        collect_garbage(hasty)
        assert keys_of(hasty.store) == []
        with refused_as("hold_lost", match="300 s"):
            hold.check()


def test_a_hold_is_put_off_until_it_ends(platform: Platform) -> None:
    with gc_hold(platform.database, "backup") as hold:
        with platform.database.reading() as session:
            before_ns = session.get_one(GcHoldRow, hold.id).until_ns
        hold.check()
        with platform.database.reading() as session:
            assert session.get_one(GcHoldRow, hold.id).until_ns >= before_ns
    with platform.database.reading() as session:
        assert session.scalars(select(GcHoldRow)).all() == []
