"""Bytes come in: nothing is written where it does not belong, nothing counts that was not verified."""

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.quota import balance
from services.runtime.uploads import hashing
from services.runtime.uploads.errors import (
    ChecksumMismatchError,
    FileMismatchError,
    OffsetMismatchError,
    OverLengthError,
    UploadGoneError,
    UploadLockedError,
    UploadMissingError,
)
from services.runtime.uploads.files import HeldFile, offset_of
from services.runtime.uploads.finishing import settle_if_whole, terminate
from services.runtime.uploads.receiving import Checksum, Piece, receive
from services.runtime.uploads.rows import find
from tests.services.runtime.uploads.sending import made, make_owner, path_of, send, sha256_of, state_of

CONTENT = bytes(range(256)) * 40
WRONG = Checksum("sha1", b"\0" * 20)


def right(content: bytes) -> Checksum:
    return Checksum("sha1", hashlib.sha1(content).digest())


def test_somebody_elses_upload_does_not_exist(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    other = make_owner(platform, "bob")
    for upload_id in (upload.id, new_id()):
        with pytest.raises(UploadMissingError):
            receive(platform, upload_id, other.user_id, Piece(0, 1))


@pytest.mark.parametrize("offset", [99, 101, 0, 10**15])
def test_a_wrong_offset_is_refused_and_changes_nothing(platform: Platform, offset: int) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    send(platform, upload, 0, CONTENT[:100])
    with pytest.raises(OffsetMismatchError, match="100 bytes are here"):
        send(platform, upload, offset, CONTENT[100:200])
    assert path_of(platform, upload).read_bytes() == CONTENT[:100]


def test_an_announced_overlength_is_refused_before_a_byte_is_written(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    with pytest.raises(OverLengthError, match=f"declared with {len(CONTENT)} bytes"):
        receive(platform, upload.id, upload.owner_id, Piece(0, len(CONTENT) + 1))
    assert path_of(platform, upload).stat().st_size == 0


def test_an_overlength_that_was_not_announced_is_cut_off_again(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    send(platform, upload, 0, CONTENT[:100])
    reception = receive(platform, upload.id, upload.owner_id, Piece(100))
    assert reception is not None
    reception.write([CONTENT[100:200]])
    with pytest.raises(OverLengthError):
        reception.write([CONTENT])
    reception.close()
    assert path_of(platform, upload).read_bytes() == CONTENT[:100]
    assert send(platform, upload, 100, CONTENT[100:]).sha256 == sha256_of(CONTENT)


def test_a_second_writer_is_locked_out_while_the_first_one_writes(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    first = receive(platform, upload.id, upload.owner_id, Piece(0))
    assert first is not None
    with pytest.raises(UploadLockedError):
        receive(platform, upload.id, upload.owner_id, Piece(0))
    with pytest.raises(UploadLockedError):
        terminate(platform, find(platform.database, upload.id, upload.owner_id))
    first.close()
    assert send(platform, upload, 0, CONTENT).state == "complete"


def test_a_wrong_checksum_takes_its_bytes_back(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    send(platform, upload, 0, CONTENT[:100], right(CONTENT[:100]))
    with pytest.raises(ChecksumMismatchError, match="sha1 of bytes 100-200 differs"):
        send(platform, upload, 100, CONTENT[100:200], WRONG)
    assert path_of(platform, upload).read_bytes() == CONTENT[:100]
    done = send(platform, upload, 100, CONTENT[100:], right(CONTENT[100:]))
    assert (done.state, done.sha256) == ("complete", sha256_of(CONTENT))


def test_bytes_under_a_checksum_do_not_count_until_it_was_right(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    send(platform, upload, 0, CONTENT[:100])
    reception = receive(platform, upload.id, upload.owner_id, Piece(100, 400, right(CONTENT[100:500])))
    assert reception is not None
    reception.write([CONTENT[100:300]])
    assert offset_of(path_of(platform, upload)) == 100
    reception.break_off()
    reception.close()
    assert path_of(platform, upload).read_bytes() == CONTENT[:100]


def test_unverified_bytes_of_a_killed_process_are_discarded_by_the_next_writer(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    killed = receive(platform, upload.id, upload.owner_id, Piece(0, 400, right(CONTENT[:400])))
    assert killed is not None
    killed.write([b"not what was sent"])
    killed.close()  # as kill -9 leaves it: lock gone, mark and bytes there
    assert path_of(platform, upload).stat().st_size == 17
    assert offset_of(path_of(platform, upload)) == 0
    assert send(platform, upload, 0, CONTENT).sha256 == sha256_of(CONTENT)


def test_bytes_of_a_client_that_left_count(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    reception = receive(platform, upload.id, upload.owner_id, Piece(0, len(CONTENT)))
    assert reception is not None
    reception.write([CONTENT[:300]])
    reception.break_off()
    reception.close()
    assert offset_of(path_of(platform, upload)) == 300
    assert send(platform, upload, 300, CONTENT[300:]).state == "complete"


def test_a_file_that_is_not_the_declared_one_fails_and_gives_its_quota_back(platform_on: Platform) -> None:
    owner = make_owner(platform_on)
    upload = made(platform_on, owner, CONTENT, sha256=sha256_of(b"another file"))
    with pytest.raises(FileMismatchError, match=sha256_of(CONTENT)):
        send(platform_on, upload, 0, CONTENT)
    failed = find(platform_on.database, upload.id, owner.user_id)
    assert failed.state == "failed"
    assert sha256_of(CONTENT) in failed.detail
    assert not path_of(platform_on, upload).exists()
    with platform_on.database.reading() as session:
        assert balance(session, owner.user_id) == 0
    with pytest.raises(UploadGoneError, match="is failed"):
        send(platform_on, upload, 0, CONTENT)


@pytest.mark.parametrize("pieces", [1, 2, 7, 100])
def test_the_hash_of_the_whole_does_not_depend_on_the_pieces(platform: Platform, pieces: int) -> None:
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    step = -(-len(CONTENT) // pieces)
    for offset in range(0, len(CONTENT), step):
        upload = send(platform, upload, offset, CONTENT[offset : offset + step])
    assert (upload.state, upload.sha256) == ("complete", sha256_of(CONTENT))
    assert path_of(platform, upload).read_bytes() == CONTENT


def test_another_process_finishes_what_the_first_began(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    send(platform, upload, 0, CONTENT[:100])
    monkeypatch.setattr("services.runtime.uploads.receiving.ROLLING", hashing.RollingHashes())
    assert send(platform, upload, 100, CONTENT[100:]).state == "complete"


def test_a_hash_state_of_another_offset_is_not_used() -> None:
    rolling = hashing.RollingHashes(capacity=1)
    rolling.keep("a", 10, hashlib.sha256(b"0123456789"))
    assert rolling.take("a", 11) is None
    rolling.keep("a", 10, hashlib.sha256(b"0123456789"))
    rolling.keep("b", 1, hashlib.sha256(b"0"))
    assert rolling.take("a", 10) is None  # the oldest had to go
    state = rolling.take("b", 1)
    assert state is not None
    assert state.hexdigest() == sha256_of(b"0")


def test_a_whole_upload_takes_no_byte_but_agrees_to_none(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    send(platform, upload, 0, CONTENT)
    assert send(platform, upload, len(CONTENT), b"").state == "complete"
    with pytest.raises(OverLengthError):
        send(platform, upload, len(CONTENT), b"x")
    with pytest.raises(OffsetMismatchError):
        send(platform, upload, 0, CONTENT)
    assert path_of(platform, upload).read_bytes() == CONTENT


def test_an_upload_whose_process_died_before_its_last_step_is_completed_by_the_next_look(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    path_of(platform, upload).write_bytes(CONTENT)
    assert settle_if_whole(platform, upload).state == "complete"


def test_a_lost_file_is_said_to_be_lost(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    path_of(platform, upload).unlink()
    with pytest.raises(UploadGoneError, match="not in the uploads folder"):
        send(platform, upload, 0, CONTENT)


def test_several_finishing_requests_at_once_end_in_one_complete(platform_on: Platform) -> None:
    owner, threads = make_owner(platform_on), 6
    upload = made(platform_on, owner, CONTENT, sha256=sha256_of(CONTENT))
    send(platform_on, upload, 0, CONTENT[:-10])
    together = Barrier(threads)

    def finish(_number: int) -> str:
        together.wait(timeout=20)
        try:
            return send(platform_on, upload, len(CONTENT) - 10, CONTENT[-10:]).state
        except (UploadLockedError, OffsetMismatchError) as refusal:
            return refusal.code

    with ThreadPoolExecutor(threads) as pool:
        outcomes = list(pool.map(finish, range(threads)))
    assert outcomes.count("complete") == 1
    assert set(outcomes) <= {"complete", "upload_locked", "offset_mismatch"}
    assert state_of(platform_on, upload) == "complete"
    assert path_of(platform_on, upload).read_bytes() == CONTENT


def test_pieces_beyond_the_vector_limit_are_all_written(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    with_file = HeldFile(path_of(platform, upload))
    with_file.append([CONTENT[i : i + 1] for i in range(2000)], 0)
    with_file.close()
    assert path_of(platform, upload).read_bytes() == CONTENT[:2000]


def test_a_partial_write_is_continued(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    whole = os.pwritev

    def seven_bytes(descriptor: int, views: list[memoryview], offset: int) -> int:
        return whole(descriptor, [views[0][:7]], offset)

    monkeypatch.setattr("os.pwritev", seven_bytes)
    assert send(platform, upload, 0, CONTENT).state == "complete"
    assert path_of(platform, upload).read_bytes() == CONTENT


def test_the_whole_is_flushed_before_it_is_acknowledged_and_pieces_every_so_often(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[int] = []
    flush = os.fdatasync

    def noting(descriptor: int) -> None:
        flush(descriptor)
        flushed.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr("os.fdatasync", noting)
    monkeypatch.setattr("services.runtime.uploads.receiving.FLUSHED_BYTES", 1000)
    upload = made(platform, make_owner(platform), CONTENT[:2500])
    for offset in range(0, 2500, 400):
        before = list(flushed)
        state = send(platform, upload, offset, CONTENT[offset : min(offset + 400, 2500)]).state
        assert state == "open" or flushed != before
    assert flushed == [1200, 2000, 2500]


def test_what_is_cut_off_again_is_flushed_before_its_mark_goes(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    path = path_of(platform, upload)
    seen: list[tuple[int, int]] = []
    flush = os.fdatasync

    def noting(descriptor: int) -> None:
        flush(descriptor)
        seen.append((os.fstat(descriptor).st_size, len(list(path.parent.glob("*.unverified")))))

    monkeypatch.setattr("os.fdatasync", noting)
    with pytest.raises(ChecksumMismatchError):
        send(platform, upload, 0, CONTENT, WRONG)
    assert seen == [(0, 1)]
    assert list(path.parent.glob("*.unverified")) == []
