"""Bytes come in: nothing is written where it does not belong, nothing counts that was not verified."""

import hashlib
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from services.runtime.access.storage_quota import balance
from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.uploads import expire, files, upload_file
from services.runtime.uploads.completion import bytes_here, settle_if_whole, terminate
from services.runtime.uploads.creation import UploadDeclaration
from services.runtime.uploads.errors import BadMetadataError, FileMismatchError, UploadLockedError
from services.runtime.uploads.files import LockedUploadFile, offset_of
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.rows import find
from stone.errors import StoneError
from testing.refusals import refused_as
from testing.threads import at_once
from tests.services.runtime.uploads.sending import (
    CONTENT,
    WRONG,
    kept,
    made,
    make_owner,
    path_of,
    receiving,
    right,
    send,
    sha256_of,
    state_of,
)


def test_somebody_elses_upload_does_not_exist(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    other = make_owner(placed, "bob")
    for upload_id in (upload.id, new_id()):
        with refused_as("upload_missing"):
            receive(placed, upload_id, other.user_id, UploadChunk(0, 1))


@pytest.mark.parametrize("offset", [99, 101, 10**15])
def test_a_wrong_offset_is_refused_and_changes_nothing(placed: Platform, offset: int) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100])
    with refused_as("offset_mismatch", match="the server has 100 bytes"):
        send(placed, upload, offset, CONTENT[100:200])
    assert kept(placed, upload) == CONTENT[:100]


def test_an_announced_overlength_is_refused_before_a_byte_is_written(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    with refused_as("over_length", match=str(len(CONTENT))):
        receive(placed, upload.id, upload.owner_id, UploadChunk(0, len(CONTENT) + 1))
    assert kept(placed, upload) == b""


def test_an_overlength_that_was_not_announced_is_cut_off_again(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100])
    reception = receiving(placed, upload, UploadChunk(100))
    reception.write([CONTENT[100:200]])
    with refused_as("over_length"):
        reception.write([CONTENT])
    reception.close()
    assert kept(placed, upload) == CONTENT[:100]
    assert send(placed, upload, 100, CONTENT[100:]).sha256 == sha256_of(CONTENT)


def test_a_second_writer_is_locked_out_while_the_first_one_writes(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    first = receiving(placed, upload, UploadChunk(0))
    with pytest.raises(UploadLockedError):
        receive(placed, upload.id, upload.owner_id, UploadChunk(0))
    with pytest.raises(UploadLockedError):
        terminate(placed, find(placed.database, upload.id, upload.owner_id))
    first.close()
    assert send(placed, upload, 0, CONTENT).state == "complete"


def test_a_wrong_checksum_takes_its_bytes_back(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100], right(CONTENT[:100]))
    with refused_as("checksum_mismatch", match="100-200"):
        send(placed, upload, 100, CONTENT[100:200], WRONG)
    assert kept(placed, upload) == CONTENT[:100]
    done = send(placed, upload, 100, CONTENT[100:], right(CONTENT[100:]))
    assert (done.state, done.sha256) == ("complete", sha256_of(CONTENT))


def test_bytes_under_a_checksum_do_not_count_until_it_was_right(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT)
    send(placed, upload, 0, CONTENT[:100])
    reception = receiving(placed, upload, UploadChunk(100, 400, right(CONTENT[100:500])))
    reception.write([CONTENT[100:300]])
    assert bytes_here(placed, upload) == 100
    reception.break_off()
    reception.close()
    assert kept(placed, upload) == CONTENT[:100]


def test_bytes_of_a_client_that_left_count(placed: Platform) -> None:
    upload = made(placed, make_owner(placed), CONTENT, sha256=sha256_of(CONTENT))
    reception = receiving(placed, upload, UploadChunk(0, len(CONTENT)))
    reception.write([CONTENT[:300]])
    reception.break_off()
    reception.close()
    assert bytes_here(placed, upload) == 300
    assert send(placed, upload, 300, CONTENT[300:]).state == "complete"


def test_a_file_that_is_not_the_declared_one_fails_and_gives_its_quota_back(placed: Platform) -> None:
    owner = make_owner(placed)
    upload = made(placed, owner, CONTENT, sha256=sha256_of(b"another file"))
    with pytest.raises(FileMismatchError, match=sha256_of(CONTENT)):
        send(placed, upload, 0, CONTENT)
    failed = find(placed.database, upload.id, owner.user_id)
    assert failed.state == "failed"
    assert sha256_of(CONTENT) in failed.detail
    assert kept(placed, upload) == b""
    with placed.database.reading() as session:
        assert balance(session, owner.user_id) == 0
    with refused_as("upload_gone"):
        send(placed, upload, 0, CONTENT)


@pytest.mark.parametrize("pieces", [1, 7])
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
    monkeypatch.setattr("services.runtime.uploads.reception.ROLLING", files.RollingHashes())
    assert send(placed, upload, 100, CONTENT[100:]).state == "complete"


def test_a_hash_state_of_another_offset_is_not_used() -> None:
    rolling = files.RollingHashes(capacity=1)
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
    with refused_as("over_length"):
        send(placed, upload, len(CONTENT), b"x")
    with refused_as("offset_mismatch"):
        send(placed, upload, 0, CONTENT)
    assert kept(placed, upload) == CONTENT


def test_several_finishing_requests_at_once_end_in_one_complete(placed_on: Platform) -> None:
    upload = made(placed_on, make_owner(placed_on), CONTENT, sha256=sha256_of(CONTENT))
    send(placed_on, upload, 0, CONTENT[:-10])

    def finish(_number: int) -> str:
        try:
            return send(placed_on, upload, len(CONTENT) - 10, CONTENT[-10:]).state
        except StoneError as refusal:
            return refusal.code

    outcomes = at_once(6, finish)
    assert outcomes.count("complete") == 1
    assert set(outcomes) <= {"complete", "upload_locked", "offset_mismatch"}
    assert state_of(placed_on, upload) == "complete"
    assert kept(placed_on, upload) == CONTENT


def test_a_request_that_is_closed_at_its_last_bytes_ends_first(
    placed: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that leaves while they are written: the file is not closed between them and the end."""
    upload = made(placed, make_owner(placed), CONTENT)
    reception = receiving(placed, upload, UploadChunk(0, len(CONTENT)))
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


def test_unverified_bytes_of_a_killed_process_are_discarded_by_the_next_writer(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    killed = receiving(platform, upload, UploadChunk(0, 400, right(CONTENT[:400])))
    killed.write([b"not what was sent"])
    killed.close()  # as kill -9 leaves it: lock gone, mark and bytes there
    assert path_of(platform, upload).stat().st_size == 17
    assert offset_of(path_of(platform, upload)) == 0
    assert send(platform, upload, 0, CONTENT).sha256 == sha256_of(CONTENT)


def test_an_upload_whose_process_died_before_its_last_step_is_completed_by_the_next_look(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT, sha256=sha256_of(CONTENT))
    path_of(platform, upload).write_bytes(CONTENT)
    assert settle_if_whole(platform, upload).state == "complete"


def test_a_lost_file_is_said_to_be_lost(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    path_of(platform, upload).unlink()
    with refused_as("upload_gone"):
        send(platform, upload, 0, CONTENT)


def test_pieces_beyond_the_vector_limit_are_all_written(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    with_file = LockedUploadFile(path_of(platform, upload))
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
    monkeypatch.setattr("services.runtime.uploads.files.FLUSHED_BYTES", 1000)
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
    with refused_as("checksum_mismatch"):
        send(platform, upload, 0, CONTENT, WRONG)
    assert seen == [(0, 1)]
    assert list(path.parent.glob("*.unverified")) == []


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


@pytest.mark.parametrize(
    "name",
    ["", "  ", "..", "a/b.mcap", "..\\b.mcap", "a\nb.mcap", "a\0b", "a\u202egnp.exe", "a\ud800", "a" * 256, "ä" * 128],
)
def test_a_name_that_is_no_plain_file_name_is_refused(name: str) -> None:
    with pytest.raises(BadMetadataError):
        UploadDeclaration(name, "recording", 1)


@pytest.mark.parametrize("name", ["run.mcap", "Feldweg Süd 3.mcap", ".hidden", "走る.db3", "a" * 255])
def test_a_plain_name_is_kept_as_it_is(name: str) -> None:
    assert UploadDeclaration(name, "recording", 1).filename == name


@pytest.mark.parametrize(
    "said",
    [
        *({"purpose": purpose} for purpose in ("", "Recording", "avatar")),
        *({"sha256": sha256} for sha256 in ("abc", "g" * 64, "A" * 64, "0" * 65)),
        *({"target_id": target} for target in ("../etc", "a b", "x" * 65, "a\n")),
    ],
)
def test_what_is_no_purpose_sha256_or_id_is_refused(said: dict[str, str]) -> None:
    with pytest.raises(BadMetadataError):
        UploadDeclaration("a", **{"purpose": "recording", "length_bytes": 1, **said})
