"""A child cannot exceed the bounds of its folder in any way."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from services.runtime.sandbox import SandboxLimits, folder_bounds, sandboxed
from services.runtime.sandbox.errors import SandboxCrashedError
from services.runtime.sandbox.own_user import NOBODY_ELSE
from testing.process_states import is_running

FILES, BYTES = 50, 2**20


def limits_of(folder: Path) -> SandboxLimits:
    return SandboxLimits(folder=folder, file_bytes=2**40, folder_files=FILES, folder_bytes=BYTES)


def filled(folder: Path) -> None:
    """Fill the folder exactly to its bounds."""
    for number in range(FILES - 1):
        (folder / str(number)).touch()
    (folder / "bytes").write_bytes(bytes(BYTES))


def many_files(folder: Path) -> None:
    for number in range(FILES + 1):
        (folder / str(number)).touch()


def many_folders(folder: Path) -> None:
    for number in range(FILES + 1):
        (folder / str(number)).mkdir()


def many_bytes(folder: Path) -> None:
    for number in range(3):
        (folder / str(number)).write_bytes(bytes(BYTES // 2))


def nameless_bytes(folder: Path) -> None:
    descriptor = os.open(folder / "gone", os.O_CREAT | os.O_WRONLY)
    (folder / "gone").unlink()
    os.write(descriptor, bytes(2 * BYTES))


def deep_folders(folder: Path) -> None:
    (folder / "/".join(["deep"] * (FILES - 2))).mkdir(parents=True)
    (folder / "deep").rename(folder / "top")


def shut_folder(folder: Path) -> None:
    (folder / "shut").mkdir(mode=0o300)
    (folder / "shut" / "bytes").write_bytes(bytes(2 * BYTES))


def sparse_file(folder: Path) -> None:
    """Write a sparse file, which uses no space on the disk."""
    with (folder / "sparse").open("wb") as file:
        file.truncate(2**30)


def attempted(fill: Callable[[Path], None], folder: Path) -> bytes:
    fill(folder)
    return b"done"


@pytest.mark.parametrize("fill", [filled, sparse_file])
def test_what_a_child_may_leave_it_leaves(fill: Callable[[Path], None], tmp_path: Path) -> None:
    assert sandboxed(lambda: attempted(fill, tmp_path), limits_of(tmp_path)) == b"done"


@pytest.mark.parametrize("fill", [many_files, many_folders, many_bytes, nameless_bytes, deep_folders, shut_folder])
def test_a_child_that_fills_its_folder_is_refused(
    fill: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_bounds, "DEEPEST", FILES // 2)
    monkeypatch.setattr(folder_bounds, "PAUSE_S", 0.0)
    monkeypatch.setattr(folder_bounds, "LOOKING_SHARE", 0)

    def work() -> bytes:
        fill(tmp_path)
        while True:
            os.sched_yield()

    if fill is shut_folder and os.geteuid() == 0:
        with pytest.raises(SandboxCrashedError, match="bytes in its files"):  # root can read every folder
            sandboxed(work, limits_of(tmp_path))
        return
    with pytest.raises(SandboxCrashedError, match=r"left (more than|nested folders|a folder)"):
        sandboxed(work, limits_of(tmp_path))


def test_what_was_filled_in_a_moment_is_seen_when_the_work_is_done(tmp_path: Path) -> None:
    with pytest.raises(SandboxCrashedError, match=f"more than {FILES} files"):
        sandboxed(lambda: attempted(many_files, tmp_path), limits_of(tmp_path))


def test_the_child_that_fills_its_folder_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_bounds, "PAUSE_S", 0.0)

    def work() -> bytes:
        (tmp_path / "pid").write_text(str(os.getpid()))
        many_bytes(tmp_path)
        while True:
            os.sched_yield()

    with pytest.raises(SandboxCrashedError):
        sandboxed(work, limits_of(tmp_path))
    assert not is_running(int((tmp_path / "pid").read_text()))


@pytest.mark.skipif(os.geteuid() != 0, reason="nobody else may give files away")
def test_what_a_child_of_another_user_left_is_ours_and_what_links_lead_to_stays_theirs(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.touch()
    folder = tmp_path / "folder"
    (folder / "below").mkdir(parents=True)
    (folder / "link").symlink_to(foreign)
    theirs = NOBODY_ELSE + 7
    for path in (foreign, folder / "below", folder / "link"):
        os.chown(path, theirs, theirs, follow_symlinks=False)
    folder_bounds.give_back(folder)
    assert [path.lstat().st_uid for path in (folder / "below", folder / "link", foreign)] == [0, 0, theirs]
