"""While the collection is held no object goes; afterwards what nobody needs does."""

from pathlib import Path

import pytest
from sqlalchemy import delete, select, update

from services.runtime.orm import GcHoldRow, Job, User, new_id
from services.runtime.platform import Platform
from services.runtime.settings import Settings, StoreSettings
from services.runtime.store.blobs import keep
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.store.gc_holds import GcHoldLostError, gc_hold, is_gc_held
from services.runtime.store.workspace import Workspace


@pytest.fixture
def hasty(platform_on: Platform) -> Platform:
    settings = Settings(**{**dict(platform_on.settings), "store": StoreSettings(grace_s=0.0)})
    return Platform(settings, platform_on.database, platform_on.store)


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


def keys_of(platform: Platform) -> list[str]:
    return [stored.key for stored in platform.store.listed("")]


def test_what_nobody_needs_stays_while_held_and_goes_afterwards(hasty: Platform, tmp_path: Path) -> None:
    keys = forgotten(hasty, tmp_path)
    with gc_hold(hasty.database, "backup"):
        assert collect_garbage(hasty).objects == 0
        assert keys_of(hasty) == keys
    collect_garbage(hasty)
    assert keys_of(hasty) == []


def test_a_holder_that_died_holds_nothing_up_for_ever(hasty: Platform, tmp_path: Path) -> None:
    forgotten(hasty, tmp_path)
    with gc_hold(hasty.database, "backup") as hold:
        with hasty.database.transaction() as session:
            session.execute(update(GcHoldRow).values(until_ns=1))
            assert session.scalar(select(is_gc_held())) is False
        collect_garbage(hasty)
        assert keys_of(hasty) == []
        with pytest.raises(GcHoldLostError, match=r"\(backup\) ran out after 300 s"):
            hold.check()


def test_a_hold_is_put_off_until_it_ends(platform_on: Platform) -> None:
    with gc_hold(platform_on.database, "backup") as hold:
        with platform_on.database.reading() as session:
            before_ns = session.get_one(GcHoldRow, hold.id).until_ns
        hold.check()
        with platform_on.database.reading() as session:
            assert session.get_one(GcHoldRow, hold.id).until_ns >= before_ns
    with platform_on.database.reading() as session:
        assert session.scalars(select(GcHoldRow)).all() == []


def test_a_hold_that_somebody_took_away_is_missed(platform_on: Platform) -> None:
    with gc_hold(platform_on.database, "backup") as hold:
        with platform_on.database.transaction() as session:
            session.execute(delete(GcHoldRow))
        with pytest.raises(GcHoldLostError):
            hold.check()
