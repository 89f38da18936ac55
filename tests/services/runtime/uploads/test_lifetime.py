"""An upload comes to be, is used once, or ends: with its quota, its file, and nothing of anybody else's."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

import pytest
from sqlalchemy import update

from services.runtime.blobs import keep
from services.runtime.orm import Recording, Sequence, Upload, new_id
from services.runtime.platform import Platform
from services.runtime.quota import QuotaExceededError, balance
from services.runtime.settings import UploadSettings
from services.runtime.uploads import consume, expire, upload_file
from services.runtime.uploads.creating import create
from services.runtime.uploads.errors import (
    UploadGoneError,
    UploadLockedError,
    UploadMissingError,
    UploadPurposeError,
    UploadStateError,
    UploadTargetMissingError,
    UploadTooLargeError,
)
from services.runtime.uploads.files import HeldFile
from services.runtime.uploads.finishing import terminate
from services.runtime.uploads.receiving import Piece, receive
from services.runtime.uploads.rows import Owner, find
from tests.rows import recording_of
from tests.services.runtime.uploads.sending import (
    declared,
    made,
    make_owner,
    path_of,
    send,
    sha256_of,
    state_of,
)

CONTENT = b"a bag of bytes" * 100


def bounded(platform: Platform, **limits: int) -> Platform:
    settings = platform.settings.model_copy(update={"uploads": UploadSettings(**limits)})
    return replace(platform, settings=settings)


def used(platform: Platform, owner: Owner) -> int:
    with platform.database.reading() as session:
        return balance(session, owner.user_id)


def overdue(platform: Platform, upload: Upload) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(expires_ns=1))


def make_sequence(platform: Platform, owner: Owner, name: str = "field") -> str:
    with platform.database.transaction() as session:
        sequence = Sequence(owner_id=owner.user_id, name=name)
        session.add(sequence)
        session.flush()
        return sequence.id


def complete(platform: Platform, owner: Owner, content: bytes = CONTENT) -> Upload:
    return send(platform, made(platform, owner, content), 0, content)


def test_a_file_beyond_what_the_platform_takes_is_refused(platform: Platform) -> None:
    small = bounded(platform, max_bytes=10)
    with pytest.raises(UploadTooLargeError, match="11 bytes, at most 10"):
        made(small, make_owner(small), b"x" * 11)


def test_a_creation_over_the_quota_leaves_neither_row_nor_file_nor_debt(platform_on: Platform) -> None:
    small, owner = bounded(platform_on, owner_bytes=100), make_owner(platform_on)
    made(small, owner, b"x" * 60)
    with pytest.raises(QuotaExceededError, match="60 of 100 bytes are used and 41 more"):
        made(small, owner, b"x" * 41)
    assert used(small, owner) == 60
    assert len(list(small.settings.uploads_folder.iterdir())) == 1


def test_creations_at_once_never_overshoot_the_quota(platform_on: Platform) -> None:
    small, owner, threads = bounded(platform_on, owner_bytes=100), make_owner(platform_on), 8
    together = Barrier(threads)

    def try_to_create(_number: int) -> bool:
        together.wait(timeout=20)
        try:
            made(small, owner, b"x" * 30)
        except QuotaExceededError:
            return False
        return True

    with ThreadPoolExecutor(threads) as pool:
        assert sum(pool.map(try_to_create, range(threads))) == 3
    assert used(small, owner) == 90
    assert len(list(small.settings.uploads_folder.iterdir())) == 3


def test_a_recording_for_a_sequence_that_is_not_yours_is_refused(platform: Platform) -> None:
    ada, bob, root = make_owner(platform), make_owner(platform, "bob"), make_owner(platform, "r", "administrator")
    sequence_id = make_sequence(platform, ada)
    for owner, target in ((bob, sequence_id), (ada, new_id())):
        with pytest.raises(UploadTargetMissingError):
            create(platform, owner, declared(CONTENT, target_id=target))
    for owner in (ada, root):
        assert create(platform, owner, declared(CONTENT, target_id=sequence_id)).target_id == sequence_id


def test_a_deleted_sequence_is_no_target(platform: Platform) -> None:
    ada = make_owner(platform)
    sequence_id = make_sequence(platform, ada)
    with platform.database.transaction() as session:
        session.get_one(Sequence, sequence_id).deleted_ns = 1
    with pytest.raises(UploadTargetMissingError):
        create(platform, ada, declared(CONTENT, target_id=sequence_id))


def test_a_terminated_upload_is_gone_with_its_file_and_its_quota(platform_on: Platform) -> None:
    owner = make_owner(platform_on)
    for make in (made, complete):
        upload = make(platform_on, owner, CONTENT)
        terminate(platform_on, upload)
        assert not path_of(platform_on, upload).exists()
        assert used(platform_on, owner) == 0
        with pytest.raises(UploadGoneError, match="is terminated"):
            send(platform_on, upload, 0, CONTENT)


def test_a_file_of_the_same_owner_is_not_sent_again(platform: Platform) -> None:
    owner = make_owner(platform)
    first = complete(platform, owner)
    second = made(platform, owner, CONTENT, sha256=sha256_of(CONTENT))
    assert (second.state, second.sha256) == ("complete", sha256_of(CONTENT))
    assert os.path.samefile(path_of(platform, first), path_of(platform, second))
    assert used(platform, owner) == 2 * len(CONTENT)
    terminate(platform, first)
    assert path_of(platform, second).read_bytes() == CONTENT


def test_nobody_learns_from_dedupe_what_others_have(platform: Platform) -> None:
    complete(platform, make_owner(platform))
    upload = made(platform, make_owner(platform, "bob"), CONTENT, sha256=sha256_of(CONTENT))
    assert upload.state == "open"
    assert path_of(platform, upload).stat().st_size == 0


def test_equal_hashes_with_another_length_are_not_the_same_file(platform: Platform) -> None:
    owner = make_owner(platform)
    complete(platform, owner)
    assert made(platform, owner, CONTENT + b"x", sha256=sha256_of(CONTENT)).state == "open"


def test_an_open_upload_with_the_declared_hash_proves_nothing(platform: Platform) -> None:
    owner = make_owner(platform)
    made(platform, owner, CONTENT, sha256=sha256_of(CONTENT))
    assert made(platform, owner, CONTENT, sha256=sha256_of(CONTENT)).state == "open"


def record(platform: Platform, owner: Owner, upload: Upload) -> Recording:
    """As the register stage leaves it: the bytes are a blob, the recording names it."""
    sequence_id = make_sequence(platform, owner)
    with platform.database.transaction() as session:
        consume(session, upload.id, owner.user_id, "recording")
        blob = keep(session, platform.store, path_of(platform, upload), adopt=True)
        recording = recording_of(upload, sequence_id, "registered", blob.sha256)
        session.add(recording)
    return recording


def test_a_recording_of_the_same_owner_is_not_sent_again(platform: Platform) -> None:
    owner = make_owner(platform)
    upload = complete(platform, owner)
    record(platform, owner, upload)
    path_of(platform, upload).unlink(missing_ok=True)
    again = made(platform, owner, CONTENT, sha256=sha256_of(CONTENT))
    assert again.state == "complete"
    assert path_of(platform, again).read_bytes() == CONTENT
    assert made(platform, make_owner(platform, "bob"), CONTENT, sha256=sha256_of(CONTENT)).state == "open"


def test_an_upload_is_used_once_by_its_owner_for_its_purpose(platform_on: Platform) -> None:
    owner, bob = make_owner(platform_on), make_owner(platform_on, "bob")
    upload = complete(platform_on, owner)
    refusals = (
        (bob.user_id, "recording", UploadMissingError),
        (owner.user_id, "submission", UploadPurposeError),
    )
    for owner_id, purpose, refusal in refusals:
        with platform_on.database.transaction() as session, pytest.raises(refusal):
            consume(session, upload.id, owner_id, purpose)
    with platform_on.database.transaction() as session:
        assert consume(session, upload.id, owner.user_id, "recording").state == "consumed"
    with platform_on.database.transaction() as session, pytest.raises(UploadStateError, match="is consumed"):
        consume(session, upload.id, owner.user_id, "recording")
    assert used(platform_on, owner) == len(CONTENT)


def test_an_upload_under_way_cannot_be_used(platform: Platform) -> None:
    owner = make_owner(platform)
    upload = made(platform, owner, CONTENT)
    with platform.database.transaction() as session, pytest.raises(UploadStateError, match="is open"):
        consume(session, upload.id, owner.user_id, "recording")


def test_an_upload_in_use_cannot_be_terminated(platform: Platform) -> None:
    owner = make_owner(platform)
    upload = complete(platform, owner)
    with platform.database.transaction() as session:
        consume(session, upload.id, owner.user_id, "recording")
    with pytest.raises(UploadStateError, match="is consumed"):
        terminate(platform, find(platform.database, upload.id, owner.user_id))
    assert path_of(platform, upload).read_bytes() == CONTENT


def test_two_uses_at_once_end_in_one(platform_on: Platform) -> None:
    owner, threads = make_owner(platform_on), 6
    upload = complete(platform_on, owner)
    together = Barrier(threads)

    def use(_number: int) -> bool:
        together.wait(timeout=20)
        try:
            with platform_on.database.transaction() as session:
                consume(session, upload.id, owner.user_id, "recording")
        except UploadStateError:
            return False
        return True

    with ThreadPoolExecutor(threads) as pool:
        assert sum(pool.map(use, range(threads))) == 1


def test_what_expired_is_swept_with_its_file_and_its_quota(platform_on: Platform) -> None:
    owner = make_owner(platform_on)
    begun, whole, kept = made(platform_on, owner, CONTENT), complete(platform_on, owner), made(platform_on, owner, b"k")
    for upload in (begun, whole):
        overdue(platform_on, upload)
    assert expire(platform_on) == 2
    assert expire(platform_on) == 0
    assert [state_of(platform_on, upload) for upload in (begun, whole, kept)] == ["expired", "expired", "open"]
    assert [path.name for path in platform_on.settings.uploads_folder.iterdir()] == [kept.id]
    assert used(platform_on, owner) == 1


def test_an_overdue_upload_is_refused_before_it_is_swept(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    overdue(platform, upload)
    with pytest.raises(UploadGoneError, match="is expired"):
        send(platform, upload, 0, CONTENT)


def test_an_upload_that_is_being_written_does_not_expire(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    reception = receive(platform, upload.id, upload.owner_id, Piece(0))
    assert reception is not None
    overdue(platform, upload)
    assert expire(platform) == 0
    with pytest.raises(UploadLockedError):
        HeldFile(path_of(platform, upload))
    reception.write([CONTENT])
    assert reception.end().state == "complete"
    reception.close()


def test_an_upload_that_goes_on_is_given_its_time_again(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    soon = upload.created_ns + int(platform.settings.uploads.expires_s * 4e8)
    with platform.database.transaction() as session:
        session.execute(update(Upload).where(Upload.id == upload.id).values(expires_ns=soon))
    assert send(platform, upload, 0, CONTENT[:10]).expires_ns > soon
    assert find(platform.database, upload.id, upload.owner_id).expires_ns > soon


def test_the_sweeper_completes_what_only_lacked_its_last_step(platform: Platform) -> None:
    owner = make_owner(platform)
    good = made(platform, owner, CONTENT, sha256=sha256_of(CONTENT))
    bad = made(platform, owner, CONTENT, sha256=sha256_of(b"other"))
    for upload in (good, bad):
        path_of(platform, upload).write_bytes(CONTENT)
    expire(platform)
    assert [state_of(platform, upload) for upload in (good, bad)] == ["complete", "failed"]
    assert used(platform, owner) == len(CONTENT)


def test_the_sweeper_removes_files_of_nobody_but_not_young_ones(platform: Platform) -> None:
    old, young = (upload_file(platform.settings, new_id()) for _ in range(2))
    foreign = platform.settings.uploads_folder / "README"
    old.parent.mkdir(parents=True, exist_ok=True)
    for path in (old, young, foreign):
        path.write_bytes(b"x")
        os.utime(path, (1, 1)) if path != young else None
    expire(platform)
    assert not old.exists()
    assert young.exists()
    assert foreign.exists()


def test_the_sweeper_removes_the_bytes_of_a_recording_only_once_they_are_kept_or_it_is_gone(platform: Platform) -> None:
    owner = make_owner(platform)
    waiting, registered = complete(platform, owner), complete(platform, owner, b"other" * 9)
    sequence_id = make_sequence(platform, owner, "waiting")
    with platform.database.transaction() as session:
        consume(session, waiting.id, owner.user_id, "recording")
        recording = recording_of(waiting, sequence_id)
        session.add(recording)
    record(platform, owner, registered)
    expire(platform)
    assert path_of(platform, waiting).read_bytes() == CONTENT
    assert not path_of(platform, registered).exists()
    with platform.database.transaction() as session:
        session.delete(session.get_one(Recording, recording.id))
    expire(platform)
    assert not path_of(platform, waiting).exists()


def test_an_empty_file_is_a_file(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), b"")
    assert send(platform, upload, 0, b"").sha256 == sha256_of(b"")
