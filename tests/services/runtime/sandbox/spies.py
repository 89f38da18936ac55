"""What code of an attacker would do in a sandboxed child; run by name, since a fork server imports it."""

import os
import re
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from services.runtime.sandbox import ProgressCallback
from services.runtime.sandbox.messages import ANSWER, send_message
from stone_submissions.errors import SubmissionError

REMEMBERED = list[int]()
SECRET = re.compile(rb"stone-secret-[0-9a-f]{32}")  # what it finds is not what it looks like
PIECE_BYTES, LONGEST_BYTES = 2**20, 45


def late_package(name: str) -> bytes:
    """Import a package in the child, and return its name."""
    return import_module(name).__name__.encode()


def environment() -> bytes:
    """As it was executed, and as it is now."""
    return Path("/proc/self/environ").read_bytes() + repr(dict(os.environ)).encode()


def secrets_in_memory() -> bytes:
    """Every secret that some page of this process holds."""
    found = set[bytes]()
    with Path("/proc/self/mem").open("rb", buffering=0) as memory:
        for line in Path("/proc/self/maps").read_text().splitlines():
            place, modes, *_ = line.split()
            if not modes.startswith("rw") or line.endswith(("[vvar]", "[vsyscall]")):
                continue
            begin, end = (int(number, 16) for number in place.split("-"))
            for at in range(begin, end, PIECE_BYTES):
                memory.seek(at)
                with suppress(OSError):  # a guard page
                    found |= set(SECRET.findall(memory.read(min(PIECE_BYTES + LONGEST_BYTES, end - at))))
    return b" ".join(sorted(found))


def readable(paths: tuple[Path, ...]) -> bytes:
    """Those that it can read, of files, or list, of folders."""
    return " ".join(str(path) for path in paths if _can_read(path)).encode()


def _can_read(path: Path) -> bool:
    try:
        _ = os.listdir(path) if path.is_dir() else path.open("rb").read(1)
    except OSError:
        return False
    return True


def reachable() -> bytes:
    """Whether a socket can be had."""
    try:
        socket.socket(socket.AF_INET).close()
    except OSError:
        return b"nothing"
    return b"the network"


def bus_error(folder: Path) -> bytes:
    """Write behind the end of a mapped file: SIGBUS, by the kernel."""
    import faulthandler
    import mmap

    faulthandler.disable()
    path = folder / "short"
    path.write_bytes(bytes(mmap.PAGESIZE))
    with path.open("r+b") as file, mmap.mmap(file.fileno(), mmap.PAGESIZE) as mapped:
        file.truncate(0)
        mapped[0] = 1
    return b""


def spin(seconds: float) -> bytes:
    until_s = time.process_time() + seconds
    while time.process_time() < until_s:
        pass
    return str(os.getpid()).encode()


def sleep(told: Path) -> bytes:
    """Say who sleeps, and sleep."""
    told.write_text(str(os.getpid()))
    time.sleep(600)
    return b""


def parent() -> bytes:
    """The process that it was forked from."""
    return str(os.getppid()).encode()


def without_progress(work: Callable[[], bytes], _progress: ProgressCallback) -> bytes:
    """Work that tells nothing of how far it is."""
    return work()


def answer_of(_given: bytes) -> bytes:
    return pid()


def pid_in(_folder: Path, _progress: ProgressCallback) -> bytes:
    return pid()


def pid() -> bytes:
    return str(os.getpid()).encode()


def remember() -> bytes:
    """Leave something behind for the next job in this process, and say who did."""
    REMEMBERED.append(os.getpid())
    return pid()


def end_if_remembered() -> bytes:
    """Break where another job was before."""
    if REMEMBERED:
        os.abort()
    return pid()


def end_by(number: int) -> bytes:
    os.kill(os.getpid(), number)
    return b""


def refuse() -> bytes:
    raise SubmissionError("corrupt", "sound bytes", "something else")


def allocate(count_bytes: int) -> bytes:
    return str(len(bytearray(count_bytes))).encode()


def answer_twice(payload: bytes) -> bytes:
    """Say this, as an answer, by whatever descriptor can be written to; then answer."""
    for descriptor in range(3, 64):
        with suppress(OSError):
            send_message(descriptor, ANSWER, payload)
    return b"the answer"
