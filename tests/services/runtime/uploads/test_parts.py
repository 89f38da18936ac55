"""Bytes under way in the store: what is added stays, of two writers one goes on, what was not added is collected.

Other machines read copies; a file that its owner has here is not sent again, and what others have stays unknown.
"""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from stat import S_ISREG

import pytest
from sqlalchemy import func, select, update

from services.runtime.orm import LooseObject, Recording, UploadPartRow
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.factory import open_store
from services.runtime.store.folder import FolderStore
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.store.keys import StoreFullError
from services.runtime.uploads import expire, files, part_writer
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.completion import bytes_here, terminate
from services.runtime.uploads.errors import DiskFullError
from services.runtime.uploads.expiry import _expire
from services.runtime.uploads.part_rows import announce
from services.runtime.uploads.reception import UploadChunk
from services.runtime.uploads.rows import find
from testing.refusals import refused_as
from testing.servers.fixtures import having
from tests.services.runtime.uploads.conftest import with_place
from tests.services.runtime.uploads.living import complete, overdue, record, used
from tests.services.runtime.uploads.sending import (
    BAG,
    CONTENT,
    kept,
    made,
    make_owner,
    receiving,
    right,
    send,
    sha256_of,
    state_of,
)


@pytest.fixture
def stored(platform: Platform) -> Platform:
    """New uploads lie in the store, and nothing is spared by the collection."""
    return having(with_place(platform, "store"), store={"grace_s": 0.0})


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Requests of this process do not lock each other out, as if each were another process's."""
    monkeypatch.setattr(part_writer.UPLOAD_LOCKS, "take", lambda upload_id: None)


def objects(platform: Platform) -> list[str]:
    return [found.key for found in platform.store.listed("uploads/")]


def loose(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(LooseObject)) or 0


def test_of_two_replicas_that_write_at_once_one_goes_on_and_the_other_is_told_where(
    platform_on: Platform, elsewhere: None
) -> None:
    platform = with_place(platform_on, "store")
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    first, second = (receiving(platform, upload, UploadChunk(0)) for _ in range(2))
    first.write([CONTENT[:2500]])
    first.break_off()
    second.write([CONTENT[:900]])
    with refused_as("offset_mismatch", match=r"^the server has 2500 "):
        second.end()
    first.close()
    second.close()
    assert kept(platform, upload) == CONTENT[:2500]
    assert send(platform, upload, 2500, CONTENT[2500:]).state == "complete"


def test_a_writer_that_was_overtaken_in_the_middle_adds_nothing_more(stored: Platform, elsewhere: None) -> None:
    upload = made(stored, make_owner(stored), CONTENT)
    slow = receiving(stored, upload, UploadChunk(0))
    slow.write([CONTENT[:1000]])
    slow.break_off()
    overtaking = receiving(stored, upload, UploadChunk(1000))
    overtaking.write([CONTENT[1000:1400]])
    assert overtaking.end().state == "open"

    def go_on() -> None:  # which of the two is told depends on how quick the store is
        slow.write([CONTENT[1000:3000]])
        slow.end()

    with refused_as("offset_mismatch", match=r"^the server has 1400 "):
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
    reception = receiving(stored, upload, UploadChunk(0, 2000, right(CONTENT[:2000])))
    reception.write([CONTENT[:2000]])
    with stored.database.transaction() as session:
        session.execute(update(LooseObject).values(expected_ns=0))
    collect_garbage(stored)
    with refused_as("offset_mismatch", match=r"^the server has 0 "):
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
    reception = receiving(stored, upload, UploadChunk(0))
    reception.write([CONTENT[:1500]])
    overdue(stored, upload)
    assert expire(stored) == 1
    with refused_as("upload_gone"):
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
    reception = receiving(stored, upload, UploadChunk(0))
    for offset in range(0, 50, 10):
        reception.write([CONTENT[offset : offset + 10]])
    assert bytes_here(stored, upload) >= 20
    reception.close()


def test_a_file_in_crumbs_is_not_kept_in_ever_more_objects(stored: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_writer, "MOST_PARTS", 2)
    upload = made(stored, make_owner(stored), CONTENT)
    for offset in (0, 1):
        send(stored, upload, offset, CONTENT[offset : offset + 1])
    with refused_as("too_many_small_requests"):
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
    with pytest.raises(DiskFullError) as refused:
        send(full, upload, 0, CONTENT)
    here = bytes_here(full, upload)
    assert f"{here} bytes" in str(refused.value)
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


@pytest.fixture
def on_s3(platform: Platform, s3_settings: StoreSettings) -> Platform:
    """As `here`, with a real S3."""
    settings = platform.settings.model_copy(update={"store": replace(s3_settings, grace_s=0.0)})
    return with_place(replace(platform, settings=settings, store=open_store(settings)), "store")


def another_machine(platform: Platform, folder: Path) -> Platform:
    """With a disk of its own, whose settings say nothing of uploads; database and store are the same."""
    settings = platform.settings.model_copy(
        update={"data_folder": folder, "uploads": type(platform.settings.uploads)()}
    )
    settings.__dict__.pop("root", None)
    store = open_store(settings) if settings.store.s3_bucket else platform.store
    return replace(platform, settings=settings, store=store)


def files_of(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock"]


def all_objects(platform: Platform) -> list[str]:
    return [found.key for found in platform.store.listed("")]


def test_whoever_reads_an_upload_has_a_copy_of_their_own_as_long_as_they_do(stored: Platform, tmp_path: Path) -> None:
    worker = another_machine(stored, tmp_path / "worker")
    upload = complete(stored, make_owner(stored), CONTENT)
    place = backend_of(worker, upload)
    with ExitStack() as both:
        path = both.enter_context(place.local(upload))
        with place.local(upload) as again:
            assert (again, path.name) == (path, upload.id)
        assert path.read_bytes() == CONTENT
        assert path.is_relative_to(worker.settings.root)
    assert files_of(worker.settings.root) == []
    assert files_of(stored.settings.uploads_folder) == []
    with place.local(upload) as path:
        assert path.read_bytes() == CONTENT


def test_on_s3_an_upload_comes_in_is_hashed_read_and_given_up(
    on_s3: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker = another_machine(on_s3, tmp_path / "worker")
    upload = made(on_s3, make_owner(on_s3), CONTENT, sha256=sha256_of(CONTENT))
    send(on_s3, upload, 0, CONTENT[:4500])
    monkeypatch.setattr("services.runtime.uploads.reception.ROLLING", files.RollingHashes())  # another replica's turn
    assert send(on_s3, upload, 4500, CONTENT[4500:]).sha256 == sha256_of(CONTENT)
    assert len(all_objects(on_s3)) == 5 + 6
    with backend_of(worker, upload).local(upload) as path:
        assert path.read_bytes() == CONTENT
    assert files_of(worker.settings.root) == []
    backend_of(worker, upload).remove(upload.id)
    collect_garbage(on_s3)
    assert all_objects(on_s3) == []


def test_a_file_that_is_kept_is_not_stored_again_and_not_collected_while_an_upload_needs_it(stored: Platform) -> None:
    owner = make_owner(stored)
    recording = record(stored, owner, complete(stored, owner))
    expire(stored)
    collect_garbage(stored)
    (blob_key,) = all_objects(stored)
    again = made(stored, owner, BAG, sha256=sha256_of(BAG))
    assert again.state == "complete"
    with stored.database.transaction() as session:
        session.delete(session.get_one(Recording, recording.id))
    collect_garbage(stored)
    assert all_objects(stored) == [blob_key]
    assert kept(stored, again) == BAG
    with backend_of(stored, again).local(again) as path:
        assert path == stored.store.local(blob_key)
    assert path.read_bytes() == BAG
    backend_of(stored, again).remove(again.id)
    collect_garbage(stored)
    assert all_objects(stored) == []


def test_uploads_stay_where_they_are_when_the_setting_changes(platform: Platform) -> None:
    owner = make_owner(platform)
    began = {place: made(with_place(platform, place), owner, CONTENT) for place in ("folder", "store")}
    for other, upload in (("store", began["folder"]), ("folder", began["store"])):
        changed = with_place(platform, other)
        send(changed, upload, 0, CONTENT[:3000])
        assert send(changed, upload, 3000, CONTENT[3000:]).sha256 == sha256_of(CONTENT)
        assert kept(changed, upload) == CONTENT


def bytes_in_use(platform: Platform) -> int:
    """On the disk, what has several names once."""
    root = platform.settings.root
    found = [path.stat() for folder in ("uploads", "store/uploads") for path in (root / folder).rglob("*")]
    return sum({facts.st_ino: facts.st_size for facts in found if S_ISREG(facts.st_mode)}.values())


def test_a_file_of_the_same_owner_is_not_sent_again(placed: Platform) -> None:
    owner = make_owner(placed)
    first = complete(placed, owner)
    second = made(placed, owner, BAG, sha256=sha256_of(BAG))
    assert (second.state, second.sha256) == ("complete", sha256_of(BAG))
    assert bytes_in_use(placed) == len(BAG)
    assert used(placed, owner) == 2 * len(BAG)
    terminate(placed, first)
    assert kept(placed, second) == BAG


def test_nobody_learns_from_dedupe_what_others_have(placed: Platform) -> None:
    complete(placed, make_owner(placed))
    upload = made(placed, make_owner(placed, "bob"), BAG, sha256=sha256_of(BAG))
    assert upload.state == "open"
    assert kept(placed, upload) == b""


def test_equal_hashes_with_another_length_are_not_the_same_file(placed: Platform) -> None:
    owner = make_owner(placed)
    complete(placed, owner)
    assert made(placed, owner, BAG + b"x", sha256=sha256_of(BAG)).state == "open"


def test_an_open_upload_with_the_declared_hash_proves_nothing(placed: Platform) -> None:
    owner = make_owner(placed)
    made(placed, owner, BAG, sha256=sha256_of(BAG))
    assert made(placed, owner, BAG, sha256=sha256_of(BAG)).state == "open"


def test_a_recording_of_the_same_owner_is_not_sent_again(placed: Platform) -> None:
    owner = make_owner(placed)
    upload = complete(placed, owner)
    record(placed, owner, upload)
    expire(placed)
    assert kept(placed, upload) == b""
    again = made(placed, owner, BAG, sha256=sha256_of(BAG))
    assert again.state == "complete"
    assert kept(placed, again) == BAG
    assert made(placed, make_owner(placed, "bob"), BAG, sha256=sha256_of(BAG)).state == "open"
