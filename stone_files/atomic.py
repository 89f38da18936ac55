"""Atomic output files and folders: written next to their target and renamed when complete.

**Conventions.** The staging path is `.<name>.<pid>.<random>.partial` in the target's folder, so it has the same
filesystem and the rename is atomic (POSIX `rename`). All data is flushed to disk before the rename, and the folder
after it. A failure, Ctrl-C or SIGTERM removes the staging path; the next run for the same target removes leftovers of
`kill -9` or a power cut. A staging path is stale if its process is gone and its `flock` is free. Forked workers share
the lock of their parent, so a surviving worker keeps its staging path.
"""

import fcntl
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from types import FrameType
from typing import NoReturn

from stone_files.errors import output_exists

FLUSHES = 8


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield an empty file to write; at the end, rename it to `path` and replace an earlier file.

    Raises `output_exists` before any work if `path` is a folder or a device.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise output_exists(path, "a folder" if target.is_dir() else "not a regular file")
    with _staging(target) as staging:
        with _held(staging, os.open(staging, os.O_CREAT | os.O_EXCL | os.O_RDONLY, 0o666)):
            yield staging
            flush(staging)
            os.replace(staging, target)
        flush(target.parent)


@contextmanager
def atomic_directory(path: Path, *, replaces: str | None = None) -> Iterator[Path]:
    """Yield an empty folder to fill; at the end, rename it to `path`.

    An earlier non-empty `path` is replaced only if it contains an entry named `replaces`, the mark of an earlier output
    of the same kind. A mistyped `-o ~` must not delete a home folder. The old folder is moved aside, the new folder is
    moved in, and then the old folder is deleted. The next run undoes a crash between the two moves. Raises
    `output_exists`, before any work and again at the end, if `path` is a file or another non-empty folder.
    """
    target = Path(os.path.realpath(path))
    _refuse_foreign(path, target, replaces)
    with _staging(target) as staging:
        staging.mkdir()
        with _held(staging, os.open(staging, os.O_RDONLY)):
            yield staging
            _flush_tree(staging)
            _refuse_foreign(path, target, replaces)
            _move_in(staging, target)
        flush(target.parent)


def _refuse_foreign(path: Path, target: Path, replaces: str | None) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise output_exists(path, "a file, not a folder")
    if any(target.iterdir()) and (replaces is None or not (target / replaces).exists()):
        raise output_exists(path, "a folder that is not empty")


@contextmanager
def _staging(target: Path) -> Iterator[Path]:
    """Yield a new hidden path next to `target`; remove stale ones first, and remove this one at the end unless it was
    renamed.
    """
    missing = [folder for folder in target.parents if not folder.exists()]
    target.parent.mkdir(parents=True, exist_ok=True)
    _recover(target)
    staging = target.with_name(f".{target.name}.{os.getpid()}.{token_hex(4)}.partial")
    with _sigterm_unwinds():
        try:
            yield staging
        except BaseException:
            _remove(staging)
            with suppress(OSError):
                for folder in missing:
                    folder.rmdir()
            raise


@contextmanager
def _held(staging: Path, descriptor: int) -> Iterator[None]:
    """Hold the staging path's lock, so a run in another container, which cannot see our pid, does not consider it
    stale.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


def _move_in(staging: Path, target: Path) -> None:
    aside = staging.with_suffix(".replaced")
    try:
        if target.exists():
            os.replace(target, aside)
        os.replace(staging, target)
    except BaseException:
        if aside.exists() and not target.exists():
            os.replace(aside, target)
        raise
    _remove(aside)


def _recover(target: Path) -> None:
    """Remove leftovers of dead runs; restore an output that was moved aside without a successor."""
    ours = re.compile(rf"\.{re.escape(target.name)}\.(\d+)\.[0-9a-f]{{8}}\.(partial|replaced)")
    for entry in sorted(target.parent.iterdir()):
        match = ours.fullmatch(entry.name)
        with suppress(FileNotFoundError):  # another run for the same target may be recovering too
            if match is not None and _is_stale(entry, int(match[1])):
                _put_back_or_remove(entry, target, was_output=match[2] == "replaced")


def _put_back_or_remove(entry: Path, target: Path, was_output: bool) -> None:
    if was_output and not target.exists():
        os.replace(entry, target)
    else:
        _remove(entry)


def _is_stale(entry: Path, pid: int) -> bool:
    if Path(f"/proc/{pid}").exists():
        return False
    try:
        descriptor = os.open(entry, os.O_RDONLY)
    except PermissionError:  # another user's run
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _flush_tree(folder: Path) -> None:
    """Flush all files of a folder in parallel: a label set has thousands of small files, and the disk batches their
    flushes.
    """
    with ThreadPoolExecutor(FLUSHES) as pool:
        for _ in pool.map(flush, (entry for entry in folder.rglob("*") if not entry.is_symlink())):
            pass
    flush(folder)


def flush(path: Path) -> None:
    """Flush the file or folder to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _sigterm_unwinds() -> Iterator[None]:
    """Turn SIGTERM into `SystemExit(143)` while an output is open, unless the process has its own handler."""
    in_main = threading.current_thread() is threading.main_thread()
    is_ours = in_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if is_ours:
        signal.signal(signal.SIGTERM, _exit_on_signal)
    try:
        yield
    finally:
        if is_ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _exit_on_signal(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)
