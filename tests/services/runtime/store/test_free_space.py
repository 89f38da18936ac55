"""The reserve of a disk: its size, and the operations that stop at it."""

import os
from pathlib import Path

import pytest

from services.runtime.store import free_space as module
from services.runtime.store.cache import Cache
from services.runtime.store.folder import SMALL_BYTES, FolderStore
from services.runtime.store.free_space import FreeSpace, StorageFullError, free_space, require_room

GIB = 2**30


@pytest.mark.parametrize(
    ("disk_bytes", "reserve_bytes"), [(10 * GIB, 2 * GIB), (40 * GIB, 2 * GIB), (1000 * GIB, 50 * GIB)]
)
def test_the_reserve_is_a_twentieth_of_the_disk_and_at_least_two_gib(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, disk_bytes: int, reserve_bytes: int
) -> None:
    blocks = disk_bytes // 4096
    facts = os.statvfs_result((4096, 4096, blocks, blocks // 2, blocks // 2, 0, 0, 0, 0, 255))
    monkeypatch.setattr(module.os, "statvfs", lambda _place: facts)
    assert free_space(tmp_path / "not" / "there") == FreeSpace(disk_bytes // 2, reserve_bytes)
    assert free_space(tmp_path, 7) == FreeSpace(disk_bytes // 2, 7)


def test_a_byte_more_than_what_the_reserve_leaves_is_refused_by_name(tmp_path: Path) -> None:
    space = FreeSpace(100, 40)
    assert space.takes(60)
    assert not space.takes(61)
    with pytest.raises(StorageFullError, match=f"cannot write 5 bytes: .* reserve of {2**62} bytes") as refused:
        require_room(tmp_path, 5, 2**62)
    assert refused.value.code == "storage_full"
    assert str(tmp_path) not in str(refused.value)


def test_a_folder_store_keeps_the_reserve_but_for_small_objects(tmp_path: Path) -> None:
    store = FolderStore(tmp_path / "store", 2**62)
    for name, size in (("small", SMALL_BYTES), ("large", SMALL_BYTES + 1)):
        (tmp_path / name).write_bytes(b"x" * size)
    store.write("probes/small", tmp_path / "small")
    with pytest.raises(StorageFullError):
        store.write("probes/large", tmp_path / "large")
    assert [one.key for one in store.listed("")] == ["probes/small"]


def test_the_cache_gives_up_what_is_unused_before_it_refuses(tmp_path: Path) -> None:
    room = [3]  # downloads that fit

    def download(key: str, path: Path) -> None:
        if not room[0]:
            raise StorageFullError(FreeSpace(0, 1), 1)
        room[0] -= 1
        path.write_bytes(b"12345")

    cache = Cache(tmp_path, 1000)
    old = cache.file("blobs/old", download)
    os.utime(old, (0, 0))

    def after_eviction(key: str, path: Path) -> None:
        if old.exists():
            raise StorageFullError(FreeSpace(0, 1), 1)
        path.write_bytes(b"1")

    assert cache.file("blobs/new", after_eviction).read_bytes() == b"1"
    room[0] = 0
    with pytest.raises(StorageFullError):
        cache.file("blobs/newest", download)
