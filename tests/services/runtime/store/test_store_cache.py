"""The cache in front of a bucket: whole files or none, one download for many, what is in use stays."""

import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from services.runtime.store.cache import Cache
from services.runtime.store.keys import StoreFullError
from testing.threads import at_once

OLD_S = time.time() - 7200.0


class Source:
    """Objects whose content is ten times their key's last character; counts downloads."""

    def __init__(self) -> None:
        self.downloads: list[str] = []

    def __call__(self, key: str, path: Path) -> None:
        self.downloads.append(key)
        path.write_bytes(key[-1].encode() * 10)


def files_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*") if path.is_file() and path.name != "use.lock")


def age(*paths: Path) -> None:
    for path in paths:
        os.utime(path, (OLD_S, OLD_S))


def test_a_download_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def half(key: str, path: Path) -> None:
        path.write_bytes(b"half")
        raise ConnectionError(key)

    cache = Cache(tmp_path, 100)
    with pytest.raises(ConnectionError):
        cache.file("blobs/a", half)
    assert files_in(tmp_path) == []
    assert cache.file("blobs/a", Source()).read_bytes() == b"a" * 10


def test_a_disk_without_room_is_said_so(tmp_path: Path) -> None:
    def full(key: str, path: Path) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(StoreFullError):
        Cache(tmp_path, 100).file("blobs/a", full)


def test_many_that_want_one_object_wait_for_one_download(tmp_path: Path) -> None:
    source = Source()

    def slow(key: str, path: Path) -> None:
        time.sleep(0.1)
        source(key, path)

    def ask(_number: int) -> None:
        assert Cache(tmp_path, 100).file("blobs/a", slow).read_bytes() == b"a" * 10

    at_once(8, ask)
    assert source.downloads == ["blobs/a"]
    assert files_in(tmp_path) == ["a"]


def test_above_the_limit_the_least_recently_used_goes_first(tmp_path: Path) -> None:
    cache, source = Cache(tmp_path, 25), Source()
    first, second = cache.file("blobs/a", source), cache.file("blobs/b", source)
    age(first, second)
    os.utime(second, (OLD_S - 1, OLD_S - 1))
    cache.file("blobs/c", source)
    assert files_in(tmp_path) == ["a", "c"]


def test_what_was_used_within_the_hour_stays_above_the_limit(tmp_path: Path) -> None:
    cache, source = Cache(tmp_path, 5), Source()
    age(cache.file("blobs/a", source))
    assert cache.file("blobs/a", source).exists(), "asking for it is using it"
    cache.file("blobs/b", source)
    assert files_in(tmp_path) == ["a", "b"]


def hang(folder: Path, key: str, begun: str) -> None:
    def never_ends(_key: str, path: Path) -> None:
        path.write_bytes(b"half")
        Path(begun).touch()
        time.sleep(600)

    Cache(folder, 100).file(key, never_ends)


def test_what_a_killed_download_left_is_removed_and_no_other_s(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    folder = tmp_path / "cache"
    begun = [str(tmp_path / key) for key in "ab"]
    killed, living = (
        context.Process(target=hang, args=(folder, f"blobs/{Path(name).name}", name), daemon=True) for name in begun
    )
    for process in (killed, living):
        process.start()
    deadline_s = time.monotonic() + 300
    while not all(Path(name).exists() for name in begun):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    killed.kill()
    killed.join()
    assert Cache(folder, 100).tidy() == 1
    assert len(files_in(folder)) == 1
    living.kill()
    living.join()
    source = Source()
    assert Cache(folder, 100).file("blobs/b", source).read_bytes() == b"b" * 10
    assert files_in(folder) == ["b"]


def test_the_mirror_of_a_run_that_nobody_used_for_a_day_goes(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    for name in ("old", "new"):
        (cache.work / name).mkdir(parents=True)
        (cache.work / name / "file").write_bytes(b"x")
    os.utime(cache.work / "old", (time.time() - 90_000, time.time() - 90_000))
    assert cache.tidy() == 1
    assert [path.name for path in cache.work.iterdir()] == ["new"]


def test_what_is_borrowed_goes_with_its_last_borrower(tmp_path: Path) -> None:
    cache, source = Cache(tmp_path, 100), Source()
    with cache.borrowed("uploads/a", source) as path:
        with cache.borrowed("uploads/a", source):
            pass
        assert path.read_bytes() == b"a" * 10
    assert files_in(tmp_path) == []
    assert source.downloads == ["uploads/a"]


def test_what_is_borrowed_is_not_evicted_however_long_it_takes(tmp_path: Path) -> None:
    cache, source = Cache(tmp_path, 15), Source()
    with cache.borrowed("uploads/a", source) as path:
        age(path)
        cache.file("blobs/b", source)
        assert path.exists()
    age(cache.file("uploads/c", source))
    cache.file("blobs/d", source)
    assert files_in(tmp_path) == ["b", "d"]


def test_borrowers_that_come_and_go_never_see_half_a_file(tmp_path: Path) -> None:
    source = Source()

    def borrow(_number: int) -> bytes:
        with Cache(tmp_path, 100).borrowed("uploads/a", source) as path:
            return path.read_bytes()

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(borrow, range(400))) == {b"a" * 10}
    assert files_in(tmp_path) == []


def test_a_downloader_that_is_done_leaves_the_partial_file_of_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = os.replace

    def overtaken(partial: Path, path: Path) -> None:
        whole(partial, path)
        partial.write_bytes(b"the next downloader's")

    monkeypatch.setattr(os, "replace", overtaken)
    Cache(tmp_path, 100).file("uploads/a", Source())
    assert [path.read_bytes() for path in (tmp_path / "partial").iterdir()] == [b"the next downloader's"]
