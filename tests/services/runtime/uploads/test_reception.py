"""Bytes come in: nothing is written where it does not belong, nothing counts that was not verified."""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event

import pytest

from services.runtime.access.storage_quota import balance
from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.uploads import running_hash
from services.runtime.uploads.completion import bytes_here, terminate
from services.runtime.uploads.errors import (
    ChecksumMismatchError,
    FileMismatchError,
    OffsetMismatchError,
    OverLengthError,
    UploadGoneError,
    UploadLockedError,
    UploadMissingError,
)
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.rows import find
from tests.services.runtime.uploads.sending import (
    CONTENT,
    WRONG,
    kept,
    made,
    make_owner,
    right,
    send,
    sha256_of,
    state_of,
)


def test_somebody_elses_upload_does_not_exist(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    other = make_owner(placed, "bob")
    for upload_id in (upload.id, new_id()):
        with pytest.raises(UploadMissingError):
            receive(placed, upload_id, other.user_id, UploadChunk(0, 1))


@pytest.mark.parametrize("offset", [99, 101, 0, 10**15])
def test_a_wrong_offset_is_refused_and_changes_nothing(placed: Platform, offset: int) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100])
    with pytest.raises(OffsetMismatchError, match="100 bytes are here"):
        send(placed, upload, offset, CONTENT[100:200])
    assert kept(placed, upload) == CONTENT[:100]


def test_an_announced_overlength_is_refused_before_a_byte_is_written(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    with pytest.raises(OverLengthError, match=f"declared with {len(CONTENT)} bytes"):
        receive(placed, upload.id, upload.owner_id, UploadChunk(0, len(CONTENT) + 1))
    assert kept(placed, upload) == b""


def test_an_overlength_that_was_not_announced_is_cut_off_again(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100])
    reception = receive(placed, upload.id, upload.owner_id, UploadChunk(100))
    assert reception is not None
    reception.write([CONTENT[100:200]])
    with pytest.raises(OverLengthError):
        reception.write([CONTENT])
    reception.close()
    assert kept(placed, upload) == CONTENT[:100]
    assert send(placed, upload, 100, CONTENT[100:]).sha256 == sha256_of(CONTENT)


def test_a_second_writer_is_locked_out_while_the_first_one_writes(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    first = receive(placed, upload.id, upload.owner_id, UploadChunk(0))
    assert first is not None
    with pytest.raises(UploadLockedError):
        receive(placed, upload.id, upload.owner_id, UploadChunk(0))
    with pytest.raises(UploadLockedError):
        terminate(placed, find(placed.database, upload.id, upload.owner_id))
    first.close()
    assert send(placed, upload, 0, CONTENT).state == "complete"


def test_a_wrong_checksum_takes_its_bytes_back(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100], right(CONTENT[:100]))
    with pytest.raises(ChecksumMismatchError, match="sha1 of bytes 100-200 differs"):
        send(placed, upload, 100, CONTENT[100:200], WRONG)
    assert kept(placed, upload) == CONTENT[:100]
    done = send(placed, upload, 100, CONTENT[100:], right(CONTENT[100:]))
    assert (done.state, done.sha256) == ("complete", sha256_of(CONTENT))


def test_bytes_under_a_checksum_do_not_count_until_it_was_right(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100])
    reception = receive(placed, upload.id, upload.owner_id, UploadChunk(100, 400, right(CONTENT[100:500])))
    assert reception is not None
    reception.write([CONTENT[100:300]])
    assert bytes_here(placed, upload) == 100
    reception.break_off()
    reception.close()
    assert kept(placed, upload) == CONTENT[:100]


def test_bytes_of_a_client_that_left_count(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT, sha256=sha256_of(CONTENT))
    reception = receive(placed, upload.id, upload.owner_id, UploadChunk(0, len(CONTENT)))
    assert reception is not None
    reception.write([CONTENT[:300]])
    reception.break_off()
    reception.close()
    assert bytes_here(placed, upload) == 300
    assert send(placed, upload, 300, CONTENT[300:]).state == "complete"


def test_a_file_that_is_not_the_declared_one_fails_and_gives_its_quota_back(placed_on: Platform) -> None:
    owner = make_owner(placed_on)
    upload = made(placed_on, owner, CONTENT, sha256=sha256_of(b"another file"))
    with pytest.raises(FileMismatchError, match=sha256_of(CONTENT)):
        send(placed_on, upload, 0, CONTENT)
    failed = find(placed_on.database, upload.id, owner.user_id)
    assert failed.state == "failed"
    assert sha256_of(CONTENT) in failed.detail
    assert kept(placed_on, upload) == b""
    with placed_on.database.reading() as session:
        assert balance(session, owner.user_id) == 0
    with pytest.raises(UploadGoneError, match="is failed"):
        send(placed_on, upload, 0, CONTENT)


@pytest.mark.parametrize("pieces", [1, 2, 7, 100])
def test_the_hash_of_the_whole_does_not_depend_on_the_pieces(placed: Platform, pieces: int) -> None:
    upload = made(placed, make_owner(placed), CONTENT, sha256=sha256_of(CONTENT))
    step = -(-len(CONTENT) // pieces)
    for offset in range(0, len(CONTENT), step):
        upload = send(placed, upload, offset, CONTENT[offset : offset + step])
    assert (upload.state, upload.sha256) == ("complete", sha256_of(CONTENT))
    assert kept(placed, upload) == CONTENT


def test_another_process_finishes_what_the_first_began(placed: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = made(placed, make_owner(placed), CONTENT, sha256=sha256_of(CONTENT))
    send(placed, upload, 0, CONTENT[:100])
    monkeypatch.setattr("services.runtime.uploads.reception.ROLLING", running_hash.RollingHashes())
    assert send(placed, upload, 100, CONTENT[100:]).state == "complete"


def test_a_hash_state_of_another_offset_is_not_used() -> None:
    rolling = running_hash.RollingHashes(capacity=1)
    rolling.keep("a", 10, hashlib.sha256(b"0123456789"))
    assert rolling.take("a", 11) is None
    rolling.keep("a", 10, hashlib.sha256(b"0123456789"))
    rolling.keep("b", 1, hashlib.sha256(b"0"))
    assert rolling.take("a", 10) is None  # the oldest had to go
    state = rolling.take("b", 1)
    assert state is not None
    assert state.hexdigest() == sha256_of(b"0")


def test_a_whole_upload_takes_no_byte_but_agrees_to_none(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT)
    assert send(placed, upload, len(CONTENT), b"").state == "complete"
    with pytest.raises(OverLengthError):
        send(placed, upload, len(CONTENT), b"x")
    with pytest.raises(OffsetMismatchError):
        send(placed, upload, 0, CONTENT)
    assert kept(placed, upload) == CONTENT


def test_several_finishing_requests_at_once_end_in_one_complete(placed_on: Platform) -> None:
    owner, threads = make_owner(placed_on), 6
    upload = made(placed_on, owner, CONTENT, sha256=sha256_of(CONTENT))
    send(placed_on, upload, 0, CONTENT[:-10])
    together = Barrier(threads)

    def finish(_number: int) -> str:
        together.wait(timeout=300)
        try:
            return send(placed_on, upload, len(CONTENT) - 10, CONTENT[-10:]).state
        except (UploadLockedError, OffsetMismatchError) as refusal:
            return refusal.code

    with ThreadPoolExecutor(threads) as pool:
        outcomes = list(pool.map(finish, range(threads)))
    assert outcomes.count("complete") == 1
    assert set(outcomes) <= {"complete", "upload_locked", "offset_mismatch"}
    assert state_of(placed_on, upload) == "complete"
    assert kept(placed_on, upload) == CONTENT


def test_a_request_that_is_closed_at_its_last_bytes_ends_first(
    placed: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that leaves while they are written: the file is not closed between them and the end."""
    upload = made(placed, make_owner(placed), CONTENT)
    reception = receive(placed, upload.id, upload.owner_id, UploadChunk(0, len(CONTENT)))
    assert reception is not None
    written, may_go_on, write = Event(), Event(), reception._write

    def slow(pieces: Sequence[bytes]) -> None:
        write(pieces)
        written.set()
        assert may_go_on.wait(30)

    monkeypatch.setattr(reception, "_write", slow)
    with ThreadPoolExecutor(2) as threads:
        ended = threads.submit(reception.end, [CONTENT])
        assert written.wait(30)
        closed = threads.submit(reception.close)
        with pytest.raises(TimeoutError):
            closed.result(0.2)
        may_go_on.set()
        assert ended.result(30).state == "complete"
        closed.result(30)
    assert kept(placed, upload) == CONTENT
