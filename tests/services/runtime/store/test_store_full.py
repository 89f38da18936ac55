"""A disk without room: a coded refusal, nothing half, and work goes on once there is room again."""

import os
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import func, select

from services.runtime.orm import LooseObject
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.blobs import collect_garbage, link, prepare
from services.runtime.store.folder import FolderStore
from services.runtime.store.keys import StoreFullError
from services.runtime.store.s3 import S3Store
from services.runtime.store.workspace import Workspace
from testing.servers.fixtures import make_settings

MIB = 2**20
DISK_BYTES = 4 * MIB


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A filesystem of 4 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small filesystem")
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    mounted = subprocess.run(command, check=False, capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"this machine lets nobody mount a tmpfs: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def file_of(folder: Path, size_bytes: int) -> Path:
    path = folder / f"source-{size_bytes}"
    path.write_bytes(b"x" * size_bytes)
    return path


@pytest.mark.parametrize("act", ["write", "adopt"])
def test_a_full_folder_refuses_keeps_nothing_half_and_takes_again_what_fits(
    disk: Path, tmp_path: Path, act: str
) -> None:
    store = FolderStore(disk / "store")
    place = getattr(store, act)
    place("blobs/first", file_of(tmp_path, 3 * MIB))
    with pytest.raises(StoreFullError, match=f"no space left at {disk}"):
        place("blobs/second", file_of(tmp_path, 2 * MIB))
    assert [path.name for path in disk.rglob("*") if path.is_file()] == ["first"]
    store.delete("blobs/first")
    place("blobs/second", file_of(tmp_path, 2 * MIB))
    assert store.size_bytes("blobs/second") == 2 * MIB


def test_an_adopted_file_of_the_same_disk_needs_no_room(disk: Path) -> None:
    store = FolderStore(disk / "store")
    source = file_of(disk, 3 * MIB)
    store.adopt("blobs/a", source)
    assert store.local("blobs/a").stat().st_ino == source.stat().st_ino


def test_content_that_did_not_fit_leaves_nothing_to_collect_later(
    disk: Path, platform: Platform, tmp_path: Path
) -> None:
    store = FolderStore(disk / "store")
    settings = platform.settings.model_copy(update={"store": StoreSettings(grace_s=-3600.0)})
    full = Platform(settings, platform.database, store)
    with pytest.raises(StoreFullError):
        prepare(store, platform.database, file_of(tmp_path, 5 * MIB))
    collect_garbage(full)
    with platform.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(LooseObject)) == 0
    prepared = prepare(store, platform.database, file_of(tmp_path, 2 * MIB))
    with platform.database.transaction() as session:
        assert link(session, prepared).size_bytes == 2 * MIB


def test_a_full_cache_refuses_keeps_nothing_half_and_works_when_there_is_room(
    disk: Path, s3_settings: StoreSettings, tmp_path: Path
) -> None:
    store = S3Store(make_settings(disk, store=replace(s3_settings, cache_bytes=1)))
    store.write("blobs/a", file_of(tmp_path, 3 * MIB))
    filler = file_of(disk, 2 * MIB)
    with pytest.raises(StoreFullError, match=f"no space left at {disk}"):
        store.local("blobs/a")
    assert [path.name for path in disk.rglob("*") if path.stat().st_size and path.is_file()] == [filler.name]
    filler.unlink()
    assert store.local("blobs/a").stat().st_size == 3 * MIB


def test_a_full_mirror_refuses_and_keeps_nothing_half(disk: Path, s3_settings: StoreSettings, tmp_path: Path) -> None:
    one, other = make_settings(tmp_path, store=s3_settings), make_settings(disk, store=s3_settings)
    here = Workspace(S3Store(one), one, "run")
    file_of(here.folder, 5 * MIB)
    here.push("")
    there = Workspace(S3Store(other), other, "run")
    with pytest.raises(StoreFullError, match=f"no space left at {disk}"):
        there.pull("")
    assert list(there.folder.iterdir()) == []
