"""An upload comes to be, is used once, or ends: with its quota, its bytes, and nothing of anybody else's."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier
from typing import Any

import pytest
from sqlalchemy import select, update

from services.runtime.access.storage_quota import QuotaExceededError
from services.runtime.orm import Recording, SequenceRow, Upload, new_id
from services.runtime.platform import Platform
from services.runtime.uploads import consume, expire
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.completion import settle, terminate
from services.runtime.uploads.creation import create
from services.runtime.uploads.errors import (
    UploadGoneError,
    UploadLockedError,
    UploadMissingError,
    UploadPurposeError,
    UploadStateError,
    UploadTargetMissingError,
    UploadTooLargeError,
)
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.rows import find
from testing.worlds.rows import recording_of
from tests.services.runtime.uploads.living import complete, leave_unsettled, make_sequence, overdue, record, used
from tests.services.runtime.uploads.sending import BAG, declared, kept, made, make_owner, send, sha256_of, state_of


def bounded(platform: Platform, **limits: Any) -> Platform:
    uploads = replace(platform.settings.uploads, **limits)
    return replace(platform, settings=platform.settings.model_copy(update={"uploads": uploads}))


def states(platform: Platform) -> list[str]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Upload.state)))


def files(platform: Platform) -> int:
    """How many there are in the uploads folder."""
    folder = platform.settings.uploads_folder
    return len(list(folder.iterdir())) if folder.is_dir() else 0


def test_a_file_beyond_what_the_platform_takes_is_refused(placed: Platform) -> None:
    small = bounded(placed, max_bytes=10)
    with pytest.raises(UploadTooLargeError, match="11 bytes, at most 10"):
        made(small, make_owner(small), b"x" * 11)


def test_a_creation_over_the_quota_leaves_neither_row_nor_file_nor_debt(placed_on: Platform) -> None:
    small, owner = bounded(placed_on, owner_bytes=100), make_owner(placed_on)
    made(small, owner, b"x" * 60)
    with pytest.raises(QuotaExceededError, match="60 of 100 bytes are used and 41 more"):
        made(small, owner, b"x" * 41)
    assert used(small, owner) == 60
    assert states(small) == ["open"]
    assert files(small) <= 1


def test_creations_at_once_never_overshoot_the_quota(placed_on: Platform) -> None:
    small, owner, threads = bounded(placed_on, owner_bytes=100), make_owner(placed_on), 8
    together = Barrier(threads)

    def try_to_create(_number: int) -> bool:
        together.wait(timeout=300)
        try:
            made(small, owner, b"x" * 30)
        except QuotaExceededError:
            return False
        return True

    with ThreadPoolExecutor(threads) as pool:
        assert sum(pool.map(try_to_create, range(threads))) == 3
    assert used(small, owner) == 90
    assert states(small) == ["open"] * 3
    assert files(small) <= 3


def test_a_recording_for_a_sequence_that_is_not_yours_is_refused(placed: Platform) -> None:
    ada, bob, root = make_owner(placed), make_owner(placed, "bob"), make_owner(placed, "r", "administrator")
    sequence_id = make_sequence(placed, ada)
    for owner, target in ((bob, sequence_id), (ada, new_id())):
        with pytest.raises(UploadTargetMissingError):
            create(placed, owner, declared(BAG, target_id=target))
    for owner in (ada, root):
        assert create(placed, owner, declared(BAG, target_id=sequence_id)).target_id == sequence_id


def test_a_deleted_sequence_is_no_target(placed: Platform) -> None:
    ada = make_owner(placed)
    sequence_id = make_sequence(placed, ada)
    with placed.database.transaction() as session:
        session.get_one(SequenceRow, sequence_id).deleted_ns = 1
    with pytest.raises(UploadTargetMissingError):
        create(placed, ada, declared(BAG, target_id=sequence_id))


def test_a_terminated_upload_is_gone_with_its_file_and_its_quota(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    for make in (made, complete):
        upload = make(placed_on, owner, BAG)
        terminate(placed_on, upload)
        assert kept(placed_on, upload) == b""
        assert used(placed_on, owner) == 0
        with pytest.raises(UploadGoneError, match="is terminated"):
            send(placed_on, upload, 0, BAG)


def test_an_upload_is_used_once_by_its_owner_for_its_purpose(placed_on: Platform) -> None:
    owner, bob = make_owner(placed_on), make_owner(placed_on, "bob")
    upload = complete(placed_on, owner)
    refusals = (
        (bob.user_id, "recording", UploadMissingError),
        (owner.user_id, "submission", UploadPurposeError),
    )
    for owner_id, purpose, refusal in refusals:
        with placed_on.database.transaction() as session, pytest.raises(refusal):
            consume(session, upload.id, owner_id, purpose)
    with placed_on.database.transaction() as session:
        assert consume(session, upload.id, owner.user_id, "recording").state == "consumed"
    with placed_on.database.transaction() as session, pytest.raises(UploadStateError, match="is consumed"):
        consume(session, upload.id, owner.user_id, "recording")
    assert used(placed_on, owner) == len(BAG)


def test_an_upload_under_way_cannot_be_used(placed: Platform) -> None:
    owner = make_owner(placed)
    upload = made(placed, owner, BAG)
    with placed.database.transaction() as session, pytest.raises(UploadStateError, match="is open"):
        consume(session, upload.id, owner.user_id, "recording")


def test_an_upload_in_use_cannot_be_terminated(placed: Platform) -> None:
    owner = make_owner(placed)
    upload = complete(placed, owner)
    with placed.database.transaction() as session:
        consume(session, upload.id, owner.user_id, "recording")
    with pytest.raises(UploadStateError, match="is consumed"):
        terminate(placed, find(placed.database, upload.id, owner.user_id))
    assert kept(placed, upload) == BAG


def test_two_uses_at_once_end_in_one(placed_on: Platform) -> None:
    owner, threads = make_owner(placed_on), 6
    upload = complete(placed_on, owner)
    together = Barrier(threads)

    def use(_number: int) -> bool:
        together.wait(timeout=300)
        try:
            with placed_on.database.transaction() as session:
                consume(session, upload.id, owner.user_id, "recording")
        except UploadStateError:
            return False
        return True

    with ThreadPoolExecutor(threads) as pool:
        assert sum(pool.map(use, range(threads))) == 1


def test_what_expired_is_swept_with_its_file_and_its_quota(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    begun, whole, other = made(placed_on, owner, BAG), complete(placed_on, owner), made(placed_on, owner, b"k")
    for upload in (begun, whole):
        overdue(placed_on, upload)
    assert expire(placed_on) == 2
    assert expire(placed_on) == 0
    assert [state_of(placed_on, upload) for upload in (begun, whole, other)] == ["expired", "expired", "open"]
    assert [kept(placed_on, upload) for upload in (begun, whole)] == [b"", b""]
    assert files(placed_on) <= 1
    assert used(placed_on, owner) == 1


def test_an_overdue_upload_is_refused_before_it_is_swept(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), BAG)
    overdue(placed, upload)
    with pytest.raises(UploadGoneError, match="is expired"):
        send(placed, upload, 0, BAG)


def test_an_upload_that_is_being_written_does_not_expire(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), BAG)
    reception = receive(placed, upload.id, upload.owner_id, UploadChunk(0))
    assert reception is not None
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
    with pytest.raises(UploadStateError, match="is terminated"):
        settle(placed, upload, held)
    held.close()
