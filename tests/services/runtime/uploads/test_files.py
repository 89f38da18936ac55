"""Bytes under way in a folder: written whole, flushed in time, marked while they do not count."""

import os

import pytest

from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.uploads import expire, upload_file
from services.runtime.uploads.completion import settle_if_whole
from services.runtime.uploads.errors import ChecksumMismatchError, UploadGoneError
from services.runtime.uploads.files import LockedUploadFile, offset_of
from services.runtime.uploads.reception import UploadChunk, receive
from tests.services.runtime.uploads.sending import CONTENT, WRONG, made, make_owner, path_of, right, send, sha256_of


def test_unverified_bytes_of_a_killed_process_are_discarded_by_the_next_writer(platform: Platform) -> None:
    upload = made(platform, make_owner(platform), CONTENT)
    killed = receive(platform, upload.id, upload.owner_id, UploadChunk(0, 400, right(CONTENT[:400])))
    assert killed is not None
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
    with pytest.raises(UploadGoneError, match="not in the uploads folder"):
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
    with pytest.raises(ChecksumMismatchError):
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
