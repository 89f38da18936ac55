"""The sweeper looks at some of very many uploads a turn, and misses none in the end."""

from collections.abc import Iterator

import pytest
from sqlalchemy import update

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads import expire, expiry
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.sweep_cursor import UploadCursor
from tests.services.runtime.uploads.living import complete, leave_unsettled, overdue, record, used
from tests.services.runtime.uploads.sending import BAG, kept, made, make_owner, state_of


def states(platform: Platform, *uploads: Upload) -> list[str]:
    return [state_of(platform, upload) for upload in uploads]


def expires_at(platform: Platform, upload: Upload, at_ns: int) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(expires_ns=at_ns))


def test_what_is_overdue_ends_a_slice_a_turn_the_longest_overdue_first(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    uploads = [complete(placed_on, owner, bytes([number])) for number in range(5)]
    for number, upload in enumerate(reversed(uploads)):
        expires_at(placed_on, upload, number + 1)
    cursor = UploadCursor(slice_rows=2)
    assert expire(placed_on, cursor) == 2
    assert states(placed_on, *uploads) == ["complete"] * 3 + ["expired"] * 2
    assert [expire(placed_on, cursor) for _ in range(3)] == [2, 1, 0]
    assert [kept(placed_on, upload) for upload in uploads] == [b""] * 5
    assert used(placed_on, owner) == 0


def test_one_that_is_being_written_holds_up_nobody_behind_it(placed: Platform) -> None:
    owner = make_owner(placed)
    first, second = made(placed, owner, BAG), made(placed, owner, BAG)
    reception = receive(placed, first.id, owner.user_id, UploadChunk(0))
    assert reception is not None
    for at_ns, upload in enumerate((first, second), start=1):
        expires_at(placed, upload, at_ns)
    cursor = UploadCursor(slice_rows=1)
    assert [expire(placed, cursor) for _ in range(2)] == [0, 1]
    assert states(placed, first, second) == ["open", "expired"]
    reception.close()
    assert sum(expire(placed, cursor) for _ in range(2)) == 1, "its turn comes again"


def test_one_that_cannot_be_ended_is_passed_by_for_a_round(placed: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    owner = make_owner(placed)
    first, second = made(placed, owner, BAG), made(placed, owner, BAG)
    for at_ns, upload in enumerate((first, second), start=1):
        expires_at(placed, upload, at_ns)
    end = expiry._end_overdue

    def break_down(platform: Platform, upload: Upload, detail: str) -> bool:
        if upload.id == first.id:
            raise OSError(5, "Input/output error")
        return end(platform, upload, detail)

    cursor = UploadCursor()
    monkeypatch.setattr(expiry, "_end_overdue", break_down)
    with pytest.raises(OSError, match="Input/output"):
        expire(placed, cursor)
    assert expire(placed, cursor) == 1
    assert states(placed, first, second) == ["open", "expired"]


def test_what_lacks_its_last_step_is_finished_when_its_turn_comes(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    uploads = [made(placed_on, owner, BAG) for _ in range(5)]
    leave_unsettled(placed_on, uploads[4], BAG)
    cursor = UploadCursor(slice_rows=2)
    for state in ("open", "open", "complete"):
        expire(placed_on, cursor)
        assert state_of(placed_on, uploads[4]) == state
    leave_unsettled(placed_on, uploads[0], BAG)
    expire(placed_on, cursor)
    assert state_of(placed_on, uploads[0]) == "complete", "the walk has begun anew"


def test_whole_files_are_read_again_one_at_least_and_no_more_than_the_share_allows(placed: Platform) -> None:
    owner = make_owner(placed)
    uploads = [made(placed, owner, BAG) for _ in range(3)]
    for upload in uploads:
        leave_unsettled(placed, upload, BAG)
    cursor = UploadCursor(share_s=0.0)
    for finished in (1, 2, 3):
        expire(placed, cursor)
        assert states(placed, *uploads).count("complete") == finished


def test_bytes_that_nobody_needs_are_found_some_files_a_turn(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    waiting = [made(placed_on, owner, BAG) for _ in range(3)]
    for upload in waiting:
        leave_unsettled(placed_on, upload, BAG[:1])
    registered = [complete(placed_on, owner, bytes([number]) * 9) for number in range(3)]
    for number, upload in enumerate(registered):
        record(placed_on, owner, upload, f"field-{number}")
    cursor = UploadCursor(slice_files=2)
    for _ in range(4):
        expire(placed_on, cursor)
    assert [kept(placed_on, upload) for upload in registered] == [b""] * 3
    assert [kept(placed_on, upload) for upload in waiting] == [BAG[:1]] * 3


def test_a_listing_that_breaks_off_is_begun_anew(placed: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    owner = make_owner(placed)
    for number in range(3):
        complete(placed, owner, bytes([number]))
    upload = complete(placed, owner)
    cursor = UploadCursor(slice_files=1)
    names = cursor.names_in(type(backend_of(placed, upload)))

    def broken() -> Iterator[str]:
        yield upload.id
        raise OSError(116, "Stale file handle")

    assert names.turn(broken(), 1) == [upload.id]
    with pytest.raises(OSError, match="Stale"):
        expire(placed, cursor)
    overdue(placed, upload)
    for _ in range(5):
        expire(placed, cursor)
    assert kept(placed, upload) == b""
