"""Bytes under way in the store: what is added stays, of two writers one goes on, what was not added is collected."""

from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import func, select, update

from services.runtime.orm import LooseObject, UploadPartRow
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.folder import FolderStore
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.store.keys import StoreFullError
from services.runtime.uploads import expire, part_writer
from services.runtime.uploads.completion import bytes_here, terminate
from services.runtime.uploads.errors import DiskFullError, OffsetMismatchError, TooManyUploadPartsError, UploadGoneError
from services.runtime.uploads.expiry import _expire
from services.runtime.uploads.part_rows import announce
from services.runtime.uploads.reception import UploadChunk, UploadReceiver, receive
from services.runtime.uploads.rows import find
from tests.services.runtime.uploads.conftest import with_place
from tests.services.runtime.uploads.living import complete, overdue
from tests.services.runtime.uploads.sending import (
    BAG,
    CONTENT,
    kept,
    made,
    make_owner,
    right,
    send,
    sha256_of,
    state_of,
)


@pytest.fixture
def stored(platform: Platform) -> Platform:
    """New uploads lie in the store, and nothing is spared by the collection."""
    placed = with_place(platform, "store")
    return replace(placed, settings=placed.settings.model_copy(update={"store": StoreSettings(grace_s=0.0)}))


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Requests of this process do not lock each other out, as if each were another process's."""
    monkeypatch.setattr(part_writer.UPLOAD_LOCKS, "take", lambda upload_id: None)


def begun(platform: Platform, upload_id: str, owner_id: str, offset_bytes: int = 0) -> UploadReceiver:
    reception = receive(platform, upload_id, owner_id, UploadChunk(offset_bytes))
    assert reception is not None
    return reception


def objects(platform: Platform) -> list[str]:
    return [stored.key for stored in platform.store.listed("uploads/")]


def loose(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(LooseObject)) or 0


def test_of_two_replicas_that_write_at_once_one_goes_on_and_the_other_is_told_where(
    platform_on: Platform, elsewhere: None
) -> None:
    platform = with_place(platform_on, "store")
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    first, second = (begun(platform, upload.id, upload.owner_id) for _ in range(2))
    first.write([CONTENT[:2500]])
    first.break_off()
    second.write([CONTENT[:900]])
    with pytest.raises(OffsetMismatchError, match="2500 bytes are here, not 0; resume from byte 2500"):
        second.end()
    first.close()
    second.close()
    assert kept(platform, upload) == CONTENT[:2500]
    assert send(platform, upload, 2500, CONTENT[2500:]).state == "complete"


def test_a_writer_that_was_overtaken_in_the_middle_adds_nothing_more(stored: Platform, elsewhere: None) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    slow = begun(stored, upload.id, upload.owner_id)
    slow.write([CONTENT[:1000]])
    slow.break_off()
    overtaking = begun(stored, upload.id, upload.owner_id, 1000)
    overtaking.write([CONTENT[1000:1400]])
    assert overtaking.end().state == "open"

    def go_on() -> None:  # which of the two is told depends on how quick the store is
        slow.write([CONTENT[1000:3000]])
        slow.end()

    with pytest.raises(OffsetMismatchError, match="1400 bytes are here"):
        go_on()
    slow.close()
    overtaking.close()
    assert kept(stored, upload) == CONTENT[:1400]


def test_bytes_a_killed_process_had_not_added_are_collected_and_nothing_else(stored: Platform) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    send(stored, upload, 0, CONTENT[:1500])
    killed = stored.settings.root / "killed"
    killed.write_bytes(b"x" * 700)
    for key in (f"uploads/{upload.id}/announced", f"uploads/{upload.id}/of-a-lost-row"):
        announce(stored, key, 0) if key.endswith("announced") else None
        stored.store.write(key, killed)
    assert len(objects(stored)) == 4
    collect_garbage(stored)
    assert len(objects(stored)) == 2
    assert loose(stored) == 0
    assert kept(stored, upload) == CONTENT[:1500]


def test_what_was_collected_before_it_was_added_is_not_said_to_be_here(stored: Platform) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    reception = receive(stored, upload.id, upload.owner_id, UploadChunk(0, 2000, right(CONTENT[:2000])))
    assert reception is not None
    reception.write([CONTENT[:2000]])
    with stored.database.transaction() as session:
        session.execute(update(LooseObject).values(expected_ns=0))
    collect_garbage(stored)
    with pytest.raises(OffsetMismatchError, match="0 bytes are here"):
        reception.end()
    reception.close()
    assert kept(stored, upload) == b""
    assert send(stored, upload, 0, CONTENT).state == "complete"


def test_objects_two_uploads_share_go_with_the_last_of_them(stored: Platform) -> None:
    owner = make_owner(stored)
    first = complete(stored, owner)
    second = made(stored, owner, BAG, sha256=sha256_of(BAG))
    terminate(stored, first)
    collect_garbage(stored)
    assert kept(stored, second) == BAG
    with stored.database.transaction() as session:
        assert bytes_here(stored, session.get_one(type(first), first.id)) == 0
    terminate(stored, second)
    collect_garbage(stored)
    assert objects(stored) == []


def test_an_upload_swept_while_another_process_writes_to_it_takes_nothing_more(
    stored: Platform, elsewhere: None
) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    reception = begun(stored, upload.id, upload.owner_id)
    reception.write([CONTENT[:1500]])
    overdue(stored, upload)
    assert expire(stored) == 1
    with pytest.raises(UploadGoneError, match="is expired"):
        reception.end()
    reception.close()
    collect_garbage(stored)
    assert objects(stored) == []


def test_bytes_that_come_in_put_the_end_off_even_when_the_sweeper_has_seen_it(
    stored: Platform, elsewhere: None
) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    overdue(stored, upload)
    seen = find(stored.database, upload.id, upload.owner_id)
    with stored.database.transaction() as session:
        session.get_one(type(upload), upload.id).expires_ns = upload.expires_ns
    assert _expire(stored, seen) is False
    assert state_of(stored, upload) == "open"


def test_on_a_slow_line_what_came_counts_before_a_slab_is_full(
    stored: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_writer, "OLD_S", -1.0)
    upload = made(stored, make_owner(stored), CONTENT)
    reception = begun(stored, upload.id, upload.owner_id)
    for offset in range(0, 50, 10):
        reception.write([CONTENT[offset : offset + 10]])
    assert bytes_here(stored, upload) >= 20
    reception.close()


def test_a_request_that_is_cut_off_keeps_what_came(stored: Platform) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    reception = begun(stored, upload.id, upload.owner_id)
    reception.write([CONTENT[:1700]])
    reception.close()
    assert kept(stored, upload) == CONTENT[:1700]


def test_a_file_in_crumbs_is_not_kept_in_ever_more_objects(stored: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_writer, "MOST_PARTS", 2)
    upload = made(stored, make_owner(stored), CONTENT)
    for offset in (0, 1):
        send(stored, upload, offset, CONTENT[offset : offset + 1])
    with pytest.raises(TooManyUploadPartsError, match="is kept in 2 objects"):
        send(stored, upload, 2, CONTENT[2:3])
    assert kept(stored, upload) == CONTENT[:2]


class Filling(FolderStore):
    """A store with room for so many objects."""

    room = 2

    def write(self, key: str, source: Path) -> None:
        if len(list(self.listed("uploads/"))) >= self.room:
            raise StoreFullError(self.root)
        super().write(key, source)


def test_a_full_store_is_said_and_what_fitted_counts(stored: Platform) -> None:
    filling = Filling(stored.settings.root / "store")
    full = replace(stored, store=filling)
    upload = made(full, make_owner(full), CONTENT, sha256=sha256_of(CONTENT))
    with pytest.raises(DiskFullError, match="the disk is full") as refused:
        send(full, upload, 0, CONTENT)
    here = bytes_here(full, upload)
    assert f"{here} bytes of this upload are kept" in str(refused.value)
    assert kept(full, upload) == CONTENT[:here]
    filling.room = 100
    assert send(full, upload, here, CONTENT[here:]).state == "complete"


def test_slabs_are_bounded_and_leave_no_gap(stored: Platform) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    for start, stop in ((0, 1), (1, 999), (999, 3001), (3001, len(CONTENT))):
        send(stored, upload, start, CONTENT[start:stop])
    with stored.database.reading() as session:
        rows = session.scalars(select(UploadPartRow).order_by(UploadPartRow.offset_bytes)).all()
    assert max(row.length_bytes for row in rows) == 1000
    ends = [row.offset_bytes + row.length_bytes for row in rows]
    assert [0, *ends[:-1]] == [row.offset_bytes for row in rows]
    assert ends[-1] == len(CONTENT)
