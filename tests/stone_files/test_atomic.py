"""Outputs are whole or absent, whatever ends the run."""

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

import pytest

from stone_files.atomic import atomic_directory, atomic_file
from testing.refusals import refused_as
from testing.signals import hear_signals

ROOT = Path(__file__).resolve().parents[2]
SLOW_FOLDER = """
import sys, time
from pathlib import Path
from stone_files.atomic import atomic_directory
with atomic_directory(Path(sys.argv[1]), replaces="report.json") as staging:
    (staging / "report.json").write_text("half")
    print("writing", flush=True)
    time.sleep(60)
"""


def fail_while_writing(staging: Path) -> NoReturn:
    staging.mkdir(exist_ok=True)
    (staging / "half").write_text("")
    raise KeyboardInterrupt


def leftovers(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir() if entry.name.endswith((".partial", ".replaced")))


def interrupted_run(target: Path, number: int) -> int:
    """Start a run that never ends by itself, stop it with this signal while it writes, return its exit code."""
    command = [sys.executable, "-c", SLOW_FOLDER, str(target)]
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    run = subprocess.Popen(command, cwd=ROOT, preexec_fn=hear_signals, **quiet)
    try:
        assert run.stdout is not None
        with run.stdout:
            assert run.stdout.readline() == b"writing\n"
        run.send_signal(number)
        return run.wait(timeout=300)
    finally:
        run.kill()


def dead_pid() -> int:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_a_file_appears_only_when_complete_and_the_handler_is_back_afterwards(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "out.bin") as staging:
        assert staging.parent == tmp_path
        staging.write_bytes(b"whole")
        assert not (tmp_path / "out.bin").exists()
    assert (tmp_path / "out.bin").read_bytes() == b"whole"
    assert leftovers(tmp_path) == []
    with atomic_file(tmp_path / "out"):
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_file_replaces_an_earlier_one_and_survives_a_failure(tmp_path: Path) -> None:
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")
    with pytest.raises(UnicodeEncodeError), atomic_file(target) as staging:
        staging.write_text("ne\udc00", encoding="utf-8")
    assert target.read_bytes() == b"old"
    with atomic_file(target) as staging:
        staging.write_bytes(b"new")
    assert target.read_bytes() == b"new"
    assert leftovers(tmp_path) == []


def test_a_writer_that_swaps_the_staging_file_is_still_renamed(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "out.bin") as staging:
        other = tmp_path / "other"
        other.write_bytes(b"swapped")
        os.replace(other, staging)
    assert (tmp_path / "out.bin").read_bytes() == b"swapped"


def test_a_file_respects_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with atomic_file(tmp_path / "out.bin") as staging:
            staging.write_bytes(b"")
    finally:
        os.umask(before)
    assert (tmp_path / "out.bin").stat().st_mode & 0o777 == 0o640


def test_a_folder_or_device_in_place_of_a_file_and_the_reverse_are_refused(tmp_path: Path) -> None:
    with refused_as("output_exists"), atomic_file(tmp_path):
        pytest.fail("work began")
    with refused_as("output_exists"), atomic_file(Path(os.devnull)):
        pytest.fail("work began")
    (tmp_path / "out").write_text("")
    with refused_as("output_exists"), atomic_directory(tmp_path / "out"):
        pytest.fail("work began")


def test_a_folder_appears_only_when_complete(tmp_path: Path) -> None:
    with atomic_directory(tmp_path / "deep" / "out") as staging:
        (staging / "sub").mkdir()
        (staging / "sub" / "a").write_text("a")
        assert not (tmp_path / "deep" / "out").exists()
    assert (tmp_path / "deep" / "out" / "sub" / "a").read_text() == "a"
    assert leftovers(tmp_path / "deep") == []


def test_a_failed_folder_leaves_nothing_not_even_the_parents_made_for_it(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), atomic_directory(tmp_path / "a" / "b" / "out") as staging:
        fail_while_writing(staging)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with atomic_directory(tmp_path / "out") as staging:
        (staging / "a").write_text("a")
    assert (tmp_path / "out" / "a").exists()


@pytest.mark.parametrize("replaces", [None, "report.json"])
def test_a_folder_that_is_not_ours_is_never_replaced(tmp_path: Path, replaces: str | None) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with refused_as("output_exists"), atomic_directory(tmp_path, replaces=replaces):
        pytest.fail("work began")
    assert (tmp_path / "thesis.tex").exists()


def test_a_folder_filled_by_somebody_else_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    theirs = tmp_path / "source"
    theirs.mkdir()
    (theirs / "theirs").write_text("")
    with refused_as("output_exists"), atomic_directory(tmp_path / "out"):
        shutil.copytree(theirs, tmp_path / "out")
    assert leftovers(tmp_path) == []
    assert (tmp_path / "out" / "theirs").exists()


def test_an_earlier_output_of_ours_is_replaced_whole(tmp_path: Path) -> None:
    for text in ("first", "second"):
        with atomic_directory(tmp_path / "out", replaces="report.json") as staging:
            (staging / "report.json").write_text(text)
            (staging / text).write_text("")
    assert sorted(entry.name for entry in (tmp_path / "out").iterdir()) == ["report.json", "second"]
    assert leftovers(tmp_path) == []


def test_a_link_to_a_folder_is_followed_and_kept(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk" / "real")
    with atomic_directory(tmp_path / "out") as staging:
        (staging / "a").write_text("a")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "disk" / "real" / "a").exists()


def test_stale_stagings_go_and_those_at_work_stay(tmp_path: Path) -> None:
    stale = tmp_path / f".out.{dead_pid()}.0123abcd.partial"
    stale.mkdir()
    (stale / "half").write_text("")
    at_work = tmp_path / f".out.{os.getppid()}.0123abcd.partial"
    at_work.mkdir()
    somebody_elses = tmp_path / f".other.{dead_pid()}.0123abcd.partial"
    somebody_elses.mkdir()
    with atomic_directory(tmp_path / "out"):
        assert not stale.exists()
    assert leftovers(tmp_path) == sorted([at_work.name, somebody_elses.name])


def test_a_staging_whose_lock_is_held_stays_though_its_pid_is_unknown_here(tmp_path: Path) -> None:
    elsewhere = tmp_path / f".out.{dead_pid()}.0123abcd.partial"
    elsewhere.mkdir()
    descriptor = os.open(elsewhere, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        with atomic_directory(tmp_path / "out"):
            pass
    finally:
        os.close(descriptor)
    assert leftovers(tmp_path) == [elsewhere.name]


def test_an_output_moved_aside_by_a_run_that_died_is_put_back(tmp_path: Path) -> None:
    aside = tmp_path / f".out.{dead_pid()}.0123abcd.replaced"
    aside.mkdir()
    (aside / "report.json").write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_directory(tmp_path / "out", replaces="report.json"):
        raise ZeroDivisionError
    assert (tmp_path / "out" / "report.json").read_text() == "old"


def test_a_move_that_fails_puts_the_earlier_output_back(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.json").write_text("old")
    with pytest.raises(FileNotFoundError), atomic_directory(tmp_path / "out", replaces="report.json") as staging:
        staging.rename(tmp_path / "elsewhere")
    assert (tmp_path / "out" / "report.json").read_text() == "old"
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)])
def test_an_interrupted_run_leaves_nothing(tmp_path: Path, number: int, code: int) -> None:
    assert interrupted_run(tmp_path / "out", number) == code
    assert list(tmp_path.iterdir()) == []


def test_a_killed_run_leaves_no_target_and_the_next_run_clears_its_staging(tmp_path: Path) -> None:
    target = tmp_path / "out"
    assert interrupted_run(target, signal.SIGKILL) == -signal.SIGKILL
    assert not target.exists()
    assert len(leftovers(tmp_path)) == 1
    with atomic_directory(target, replaces="report.json") as staging:
        (staging / "report.json").write_text("whole")
    assert (target / "report.json").read_text() == "whole"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_a_killed_rerun_keeps_the_earlier_output(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with atomic_directory(target) as staging:
        (staging / "report.json").write_text("whole")
    assert interrupted_run(target, signal.SIGKILL) == -signal.SIGKILL
    assert (target / "report.json").read_text() == "whole"


def test_a_process_with_its_own_handler_keeps_it(tmp_path: Path) -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    try:
        with atomic_file(tmp_path / "out"):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.01)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIGTERM]
    assert (tmp_path / "out").exists()
