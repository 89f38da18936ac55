"""The reach of a compromised sandboxed child: `python -m benchmarks.sandbox_reach [--kernel NAME]`.

A child of each kind tries all `ATTEMPTS` by native means. It may write in one folder and read one file. A file, a
folder and a process of the same user are outside its grants. If an attempt leaves a trace outside, the trace is checked
from outside; otherwise the child's own answer counts.

**Conventions.** `--kernel` removes the features that an older kernel lacks: newer versions of Landlock, or all of it.
Root's children usually have a user of their own, which alone refuses many attempts. Here they keep the service's user,
like children of any other user. `docs/security/sandbox.md` contains the table, and a test compares it with this
program.
"""

import argparse
import ctypes
import errno
import fcntl
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

from rich.console import Console
from rich.table import Table

from services.runtime.sandbox import SandboxLimits, child, fences, sandboxed, seccomp
from services.runtime.sandbox.seccomp import KINDS
from stone.errors import StoneError
from testing.system_calls import system_call

KERNELS: Mapping[str, int | None] = {"this": None, "6.10": 5, "6.1": 2, "no Landlock": 0}
"""The version of Landlock of each kernel, by the kernel's name; None is the version of this kernel."""
YES, NO = "yes", "–"
ENDED_WITHIN_S = 0.2
AT_FDCWD = -100


@dataclass(frozen=True)
class Ground:
    """The files, folders and process (`victim`) of a child's attempts."""

    folder: Path
    given: Path
    foreign: Path
    victim: int

    @property
    def own(self) -> Path:
        return self.folder / "own"

    @property
    def beside(self) -> Path:
        """The folder outside the child's grants."""
        return self.foreign.parent


Act = Callable[[Ground], object]
Trace = Callable[[Ground], object]


def _signal_by_descriptor(ground: Ground) -> None:
    reading, writing = os.pipe()
    fcntl.fcntl(reading, fcntl.F_SETOWN, ground.victim)
    fcntl.fcntl(reading, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(reading, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
    os.write(writing, b"x")


def _limit(ground: Ground) -> None:
    resource.prlimit(ground.victim, resource.RLIMIT_NOFILE, (16, 16))


def _mode(ground: Ground) -> int:
    return ground.foreign.stat().st_mode


def _alive(ground: Ground) -> bool:
    until_s = time.monotonic() + ENDED_WITHIN_S
    while time.monotonic() < until_s:
        with suppress(ProcessLookupError, FileNotFoundError):
            if Path(f"/proc/{ground.victim}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return False
        time.sleep(0.01)
    return True


def _set_attribute(name: str, ground: Ground) -> None:
    value = b"attribute"
    if name == "setxattr":
        os.setxattr(ground.foreign, "user.stone", value)
        return
    kept = ctypes.create_string_buffer(value)
    given = struct.pack("<QII", ctypes.addressof(kept), len(value), 0)
    system_call(name, AT_FDCWD, bytes(ground.foreign), 0, b"user.stone", given, len(given))


ATTEMPTS: Mapping[str, tuple[Act, Trace | None]] = {
    "read a file it was not given": (lambda at: at.foreign.read_bytes(), None),
    "list a folder it was not given": (lambda at: os.listdir(at.beside), None),
    "learn the size of a file it was not given": (lambda at: at.foreign.stat(), None),
    "make a file in its folder": (lambda at: (at.folder / "made").touch(), lambda at: (at.folder / "made").exists()),
    "make a link in its folder": (lambda at: (at.folder / "link").symlink_to("/"), None),
    "make a file elsewhere": (lambda at: (at.beside / "made").touch(), lambda at: (at.beside / "made").exists()),
    "write to its input": (lambda at: at.given.open("r+b").write(b"x"), lambda at: at.given.read_bytes()),
    "truncate its input by its path": (
        lambda at: os.truncate(at.given, 0),
        lambda at: at.given.stat().st_size,
    ),
    "truncate its input, opened for reading": (
        lambda at: os.open(at.given, os.O_RDONLY | os.O_TRUNC),
        lambda at: at.given.stat().st_size,
    ),
    "remove a file elsewhere": (lambda at: at.foreign.unlink(), lambda at: at.foreign.exists()),
    "change a mode elsewhere": (lambda at: at.foreign.chmod(0o666), _mode),
    "change a mode in its folder": (lambda at: at.own.chmod(0o666), lambda at: at.own.stat().st_mode),
    "change a mode by a descriptor": (
        lambda at: os.fchmod(os.open(at.given, os.O_RDONLY), 0o666),
        lambda at: at.given.stat().st_mode,
    ),
    "change a time elsewhere": (lambda at: os.utime(at.foreign, (1, 1)), lambda at: at.foreign.stat().st_mtime),
    "set an attribute elsewhere": (partial(_set_attribute, "setxattr"), lambda at: os.listxattr(at.foreign)),
    "set one by the newer call": (partial(_set_attribute, "setxattrat"), lambda at: os.listxattr(at.foreign)),
    "call what is newer than the list": (lambda _: system_call("unknown yet"), None),
    "lock its input": (lambda at: fcntl.flock(at.given.open(), fcntl.LOCK_EX), None),
    "start a process": (lambda _: os.fork() or os._exit(0), None),
    "open a socket": (lambda _: socket.socket(), None),
    "signal another process": (lambda at: os.kill(at.victim, signal.SIGKILL), _alive),
    "signal another process through a descriptor's owner": (_signal_by_descriptor, _alive),
    "slow another process down": (
        lambda at: os.setpriority(os.PRIO_PROCESS, at.victim, 19),
        lambda at: os.getpriority(os.PRIO_PROCESS, at.victim),
    ),
    "pin another process to one processor": (
        lambda at: os.sched_setaffinity(at.victim, [min(os.sched_getaffinity(0))]),
        None,
    ),
    "let another process run only on an idle processor": (
        lambda at: os.sched_setscheduler(at.victim, os.SCHED_IDLE, os.sched_param(0)),
        lambda at: os.sched_getscheduler(at.victim),
    ),
    "lower another process's disk priority": (lambda at: system_call("ioprio_set", 1, at.victim, 3 << 13), None),
    "lower another process's limits": (_limit, lambda at: resource.prlimit(at.victim, resource.RLIMIT_NOFILE)),
    "read another process's environment": (lambda at: Path(f"/proc/{at.victim}/environ").read_bytes(), None),
}


def reach(kind: str, name: str, kernel: str = "this", *, is_fenced: bool = True) -> str:
    """Return `yes` if a child of the kind succeeds with the attempt on this kernel, else `–` or the error."""
    act, trace = ATTEMPTS[name]
    with _ground() as ground, _older(KERNELS[kernel]), nullcontext() if is_fenced else _unfenced():
        before = trace(ground) if trace else None
        folder = None if kind == "reads" else ground.folder
        limits = SandboxLimits(folder=folder, file_bytes=2**20, reads=(ground.given,), makes_links=kind == "links")
        try:
            answer = sandboxed(partial(_tried, act, ground), limits).decode()
        except StoneError as error:
            answer = str(error)
        happened = trace(ground) != before if trace else answer == YES
    return YES if happened else NO if answer == YES else answer


def _tried(act: Act, ground: Ground) -> bytes:
    try:
        act(ground)
    except OSError as error:
        return errno.errorcode[error.errno or 0].encode()
    return YES.encode()


@contextmanager
def _ground() -> Iterator[Ground]:
    with tempfile.TemporaryDirectory(prefix="stone-reach-") as root:
        folder, beside = Path(root, "folder"), Path(root, "beside")
        folder.mkdir()
        beside.mkdir()
        victim = subprocess.Popen([sys.executable, "-S", "-c", "import signal; signal.pause()"])
        ground = Ground(folder, Path(root, "given"), beside / "foreign", victim.pid)
        for path in (ground.own, ground.given, ground.foreign):
            path.write_bytes(b"stays")
            path.chmod(0o600)
        try:
            yield ground
        finally:
            victim.kill()
            victim.wait()


@contextmanager
def _older(landlock: int | None) -> Iterator[None]:
    """Fork children from this process (no fork server), with the service's user and at most this Landlock."""
    version = fences.version() if landlock is None else min(landlock, fences.version())
    with patch.object(child, "leave_the_user", lambda: False), patch.object(fences, "version", lambda: version):
        yield


@contextmanager
def _unfenced() -> Iterator[None]:
    """Fork children without any fence, to show that each attempt can succeed."""
    with ExitStack() as patches:
        patches.enter_context(patch.object(fences, "version", lambda: 0))
        patches.enter_context(patch.object(seccomp, "allow_calls", lambda _: False))
        patches.enter_context(patch.object(fences, "_leave_the_network", lambda: False))
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kernel", choices=list(KERNELS), action="append", help="kernel to simulate (default: all)")
    kernels = parser.parse_args().kernel or list(KERNELS)
    table = Table("", *(f"{kind}, {kernel}" for kernel in kernels for kind in KINDS))
    for name in ATTEMPTS:
        table.add_row(name, *(reach(kind, name, kernel) for kernel in kernels for kind in KINDS))
    Console(width=240).print(table)


if __name__ == "__main__":
    main()
