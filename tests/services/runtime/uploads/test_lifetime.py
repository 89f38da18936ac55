"""An upload comes to be, is used once, or ends: with its quota, its bytes, and nothing of anybody else's."""

from collections.abc import Iterator

import pytest
from sqlalchemy import select, update

from services.runtime.orm import Recording, SequenceRow, Upload, new_id
from services.runtime.platform import Platform
from services.runtime.uploads import consume, expire, expiry
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.completion import settle, terminate
from services.runtime.uploads.creation import create
from services.runtime.uploads.errors import UploadLockedError
from services.runtime.uploads.expiry import UploadCursor
from services.runtime.uploads.reception import UploadChunk
from services.runtime.uploads.rows import find
from testing.refusals import refused_as
from testing.servers.fixtures import having
from testing.threads import granted
from testing.worlds.rows import recording_of
from tests.services.runtime.jobs.steps import act
from tests.services.runtime.uploads.living import complete, leave_unsettled, make_sequence, overdue, record, used
from tests.services.runtime.uploads.sending import (
    BAG,
    declared,
    kept,
    made,
    make_owner,
    receiving,
    send,
    sha256_of,
    state_of,
)


def states(platform: Platform) -> list[str]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Upload.state)))


def files(platform: Platform) -> int:
    """How many there are in the uploads folder."""
    folder = platform.settings.uploads_folder
    return len(list(folder.iterdir())) if folder.is_dir() else 0


def test_a_file_beyond_what_the_platform_takes_is_refused(placed: Platform) -> None:
    small = having(placed, uploads={"max_bytes": 10})
    with refused_as("upload_too_large", match="11 bytes"):
        made(small, make_owner(small), b"x" * 11)


def test_creations_at_once_never_overshoot_the_quota(placed_on: Platform) -> None:
    small, owner = having(placed_on, uploads={"owner_bytes": 100}), make_owner(placed_on)
    assert granted(8, lambda _: made(small, owner, b"x" * 30), "quota_exceeded") == 3
    assert used(small, owner) == 90
    assert states(small) == ["open"] * 3
    assert files(small) <= 3


def test_a_recording_for_a_sequence_that_is_not_yours_or_deleted_is_refused(placed: Platform) -> None:
    ada, bob, root = make_owner(placed), make_owner(placed, "bob"), make_owner(placed, "r", "administrator")
    sequence_id = make_sequence(placed, ada)
    for owner, target in ((bob, sequence_id), (ada, new_id())):
        with refused_as("upload_target_missing"):
            create(placed, owner, declared(BAG, target_id=target))
    for owner in (ada, root):
        assert create(placed, owner, declared(BAG, target_id=sequence_id)).target_id == sequence_id
    with placed.database.transaction() as session:
        session.get_one(SequenceRow, sequence_id).deleted_ns = 1
    with refused_as("upload_target_missing"):
        create(placed, ada, declared(BAG, target_id=sequence_id))


def test_a_terminated_upload_is_gone_with_its_file_and_its_quota(placed: Platform) -> None:
    owner = make_owner(placed)
    for make in (made, complete):
        upload = make(placed, owner, BAG)
        terminate(placed, upload)
        assert kept(placed, upload) == b""
        assert used(placed, owner) == 0
        with refused_as("upload_gone"):
            send(placed, upload, 0, BAG)


def test_an_upload_is_used_once_by_its_owner_for_its_purpose(placed: Platform) -> None:
    owner, bob = make_owner(placed), make_owner(placed, "bob")
    upload = complete(placed, owner)
    refusals = (
        (bob.user_id, "recording", "upload_missing"),
        (owner.user_id, "submission", "wrong_upload_purpose"),
    )
    for owner_id, purpose, refusal in refusals:
        with placed.database.transaction() as session, refused_as(refusal):
            consume(session, upload.id, owner_id, purpose)
    assert act(placed, consume, upload.id, owner.user_id, "recording").state == "consumed"
    for unusable in (upload, made(placed, owner, b"")):
        with placed.database.transaction() as session, refused_as("wrong_upload_state"):
            consume(session, unusable.id, owner.user_id, "recording")
    assert used(placed, owner) == len(BAG)


def test_an_upload_in_use_cannot_be_terminated(placed: Platform) -> None:
    owner = make_owner(placed)
    upload = complete(placed, owner)
    act(placed, consume, upload.id, owner.user_id, "recording")
    with refused_as("wrong_upload_state"):
        terminate(placed, find(placed.database, upload.id, owner.user_id))
    assert kept(placed, upload) == BAG


def test_two_uses_at_once_end_in_one(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    upload = complete(placed_on, owner)

    def use(_number: int) -> None:
        act(placed_on, consume, upload.id, owner.user_id, "recording")

    assert granted(6, use, "wrong_upload_state") == 1


def test_what_expired_is_swept_with_its_file_and_its_quota(placed: Platform) -> None:
    owner = make_owner(placed)
    begun, whole, other = made(placed, owner, BAG), complete(placed, owner), made(placed, owner, b"k")
    for upload in (begun, whole):
        overdue(placed, upload)
    assert expire(placed) == 2
    assert expire(placed) == 0
    assert [state_of(placed, upload) for upload in (begun, whole, other)] == ["expired", "expired", "open"]
    assert [kept(placed, upload) for upload in (begun, whole)] == [b"", b""]
    assert files(placed) <= 1
    assert used(placed, owner) == 1


def test_an_overdue_upload_is_refused_before_it_is_swept(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), BAG)
    overdue(placed, upload)
    with refused_as("upload_gone"):
        send(placed, upload, 0, BAG)


def test_an_upload_that_is_being_written_does_not_expire(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), BAG)
    reception = receiving(placed, upload, UploadChunk(0))
    overdue(placed, upload)
    assert expire(placed) == 0
    with pytest.raises(UploadLockedError):
        backend_of(placed, upload).hold(upload)
    reception.write([BAG])
    assert reception.end().state == "complete"
    reception.close()


def test_an_upload_that_goes_on_is_given_its_time_again(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), BAG)
    soon = upload.created_ns + int(placed.settings.uploads.expires_s * 4e8)
    with placed.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(expires_ns=soon))
    assert send(placed, upload, 0, BAG[:10]).expires_ns > soon
    assert find(placed.database, upload.id, upload.owner_id).expires_ns > soon


def test_the_sweeper_completes_what_only_lacked_its_last_step(placed: Platform) -> None:
    owner = make_owner(placed)
    good = made(placed, owner, BAG, sha256=sha256_of(BAG))
    bad = made(placed, owner, BAG, sha256=sha256_of(b"other"))
    for upload in (good, bad):
        leave_unsettled(placed, upload, BAG)
    expire(placed)
    assert [state_of(placed, upload) for upload in (good, bad)] == ["complete", "failed"]
    assert used(placed, owner) == len(BAG)


def test_the_sweeper_removes_the_bytes_of_a_recording_only_once_they_are_kept_or_it_is_gone(placed: Platform) -> None:
    owner = make_owner(placed)
    waiting, registered = complete(placed, owner), complete(placed, owner, b"other" * 9)
    sequence_id = make_sequence(placed, owner, "waiting")
    with placed.database.transaction() as session:
        consume(session, waiting.id, owner.user_id, "recording")
        recording = recording_of(waiting, sequence_id)
        session.add(recording)
    record(placed, owner, registered)
    expire(placed)
    assert kept(placed, waiting) == BAG
    assert kept(placed, registered) == b""
    with placed.database.transaction() as session:
        session.delete(session.get_one(Recording, recording.id))
    expire(placed)
    assert kept(placed, waiting) == b""


def test_an_empty_file_is_a_file(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), b"")
    assert send(placed, upload, 0, b"").sha256 == sha256_of(b"")


def test_an_upload_that_was_given_up_meanwhile_is_not_called_complete(placed: Platform) -> None:
    """Its last bytes were kept, and its row had left for another state before they were settled."""
    upload = made(placed, make_owner(placed), BAG)
    leave_unsettled(placed, upload, BAG)
    held = backend_of(placed, upload).hold(upload)
    with placed.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(state="terminated"))
    with refused_as("wrong_upload_state"):
        settle(placed, upload, held)
    held.close()


def states_of(platform: Platform, *uploads: Upload) -> list[str]:
    return [state_of(platform, upload) for upload in uploads]


def expires_at(platform: Platform, upload: Upload, at_ns: int) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(expires_ns=at_ns))


def test_what_is_overdue_ends_a_slice_a_turn_the_longest_overdue_first(placed: Platform) -> None:
    owner = make_owner(placed)
    uploads = [complete(placed, owner, bytes([number])) for number in range(5)]
    for number, upload in enumerate(reversed(uploads)):
        expires_at(placed, upload, number + 1)
    cursor = UploadCursor(slice_rows=2)
    assert expire(placed, cursor) == 2
    assert states_of(placed, *uploads) == ["complete"] * 3 + ["expired"] * 2
    assert [expire(placed, cursor) for _ in range(3)] == [2, 1, 0]
    assert [kept(placed, upload) for upload in uploads] == [b""] * 5
    assert used(placed, owner) == 0


def test_one_that_is_being_written_holds_up_nobody_behind_it(placed: Platform) -> None:
    owner = make_owner(placed)
    first, second = made(placed, owner, BAG), made(placed, owner, BAG)
    reception = receiving(placed, first, UploadChunk(0))
    for at_ns, upload in enumerate((first, second), start=1):
        expires_at(placed, upload, at_ns)
    cursor = UploadCursor(slice_rows=1)
    assert [expire(placed, cursor) for _ in range(2)] == [0, 1]
    assert states_of(placed, first, second) == ["open", "expired"]
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
    assert states_of(placed, first, second) == ["open", "expired"]


def test_what_lacks_its_last_step_is_finished_when_its_turn_comes(placed: Platform) -> None:
    owner = make_owner(placed)
    uploads = [made(placed, owner, BAG) for _ in range(5)]
    leave_unsettled(placed, uploads[4], BAG)
    cursor = UploadCursor(slice_rows=2)
    for state in ("open", "open", "complete"):
        expire(placed, cursor)
        assert state_of(placed, uploads[4]) == state
    leave_unsettled(placed, uploads[0], BAG)
    expire(placed, cursor)
    assert state_of(placed, uploads[0]) == "complete", "the walk has begun anew"


def test_bytes_that_nobody_needs_are_found_some_files_a_turn(placed: Platform) -> None:
    owner = make_owner(placed)
    waiting = [made(placed, owner, BAG) for _ in range(3)]
    for upload in waiting:
        leave_unsettled(placed, upload, BAG[:1])
    registered = [complete(placed, owner, bytes([number]) * 9) for number in range(3)]
    for number, upload in enumerate(registered):
        record(placed, owner, upload, f"field-{number}")
    cursor = UploadCursor(slice_files=2)
    for _ in range(4):
        expire(placed, cursor)
    assert [kept(placed, upload) for upload in registered] == [b""] * 3
    assert [kept(placed, upload) for upload in waiting] == [BAG[:1]] * 3


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
