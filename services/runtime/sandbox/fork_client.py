"""The client of the fork server: starts it and requests sandboxed children.

**Conventions.** `use_fork_server` is for entry points (a worker before it forks its pool, the API's start). From then
on the server forks every sandboxed child of this process and of its forks, so no child comes from a process with keys.
If the server dies (of memory), the next request starts it again. Processes without keys, such as a command or a test,
start no server: they fork their children themselves.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Lock

import structlog

from services.runtime.sandbox.errors import SandboxInterruptedError
from services.runtime.sandbox.fences import missing_fences
from services.runtime.sandbox.fork_server import FATE, FORKED, REQUEST, Work, parcel
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.telemetry.process_usage import ProcessUsage, note_served, usage_of

log = structlog.get_logger(__name__)

PROGRAM = "from services.runtime.sandbox.fork_server import main; main()"
# The environment variables that a child needs; all others are removed, whatever their name.
PASSED = ("PATH", "HOME", "LANG", "TZ", "TMPDIR", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "XDG_CACHE_HOME", "MPLCONFIGDIR")
PASSED_BEGINNINGS = ("LC_", "PYTHON", "NUMBA_", "OMP_", "OPENBLAS_", "MKL_")
WARMED_WITHIN_S = 900.0


@dataclass
class ForkServer:
    """The server of this process and of its forks, started at the first request."""

    warmed_by: tuple[str, ...]
    _process: subprocess.Popen[bytes] | None = None
    _requests: socket.socket | None = None
    _lock: Lock = field(default_factory=Lock)

    def ensure_running(self) -> None:
        with self._lock:
            if self._requests is None:
                self._process, self._requests = _start(self.warmed_by)

    @property
    def pid(self) -> int | None:
        """The process ID; None while there is no process."""
        return None if self._process is None else self._process.pid

    def ask(self, descriptors: Sequence[int]) -> None:
        """Send a request; if the server is gone, start it again, once. Raises `SandboxInterruptedError`."""
        for _ in range(2):
            self.ensure_running()
            requests = self._requests
            try:
                if requests is not None:
                    socket.send_fds(requests, [REQUEST], descriptors)
                    return
            except (BrokenPipeError, ConnectionError):
                with self._lock:
                    if self._requests is requests:
                        self._end()
        raise SandboxInterruptedError("could not be forked: the fork server keeps ending")

    def close(self) -> None:
        """End the server and its children."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        if self._requests is not None:
            self._requests.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._requests = None


_SERVERS: list[ForkServer] = []


def use_fork_server(warmed_by: Sequence[str]) -> ForkServer:
    """Fork sandboxed children from a server, which starts with the first child; log a warning of each missing fence.

    The server first imports the modules `warmed_by`, or calls functions of them (`module:function`).
    """
    if not _SERVERS:
        _SERVERS.append(ForkServer(tuple(warmed_by)))
        for name, follows in missing_fences().items():
            log.warning("a fence of the sandbox is missing", fence=name, follows=follows)
    return _SERVERS[0]


def fork_server() -> ForkServer | None:
    """Return the server of this process, if it has one."""
    return _SERVERS[0] if _SERVERS else None


def warm_unless_served(warm: Callable[[], None]) -> None:
    """Compile the children's kernels if this process forks them: a child could not cache them."""
    if fork_server() is None:
        warm()


def single_task(limits: SandboxLimits, work: Work) -> int:
    """Return the descriptor of a file that contains one work."""
    task = os.memfd_create("task")
    with os.fdopen(os.dup(task), "wb") as file:
        file.write(parcel(limits) + parcel(work))
    os.lseek(task, 0, os.SEEK_SET)
    return task


class ServedChild:
    """A child of the fork server: its socket reports its state, and closing the socket ends it."""

    def __init__(self, server: ForkServer, task: int, writing: int) -> None:
        """Request a child that reads its limits and works from `task`; the caller closes `task` and `writing`."""
        self._told, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.begun_s: float | None = None
        self._asked_s, self._status = time.monotonic(), None
        self._pid, self._noted_s = 0, 0.0
        try:
            server.ask([theirs.fileno(), writing, task])
        except BaseException:
            self._told.close()
            raise
        finally:
            theirs.close()

    @property
    def pid(self) -> int:
        """The process ID; 0 before the start."""
        return self._pid

    @property
    def ended(self) -> int:
        """The descriptor that is readable when the server has news of the child."""
        return self._told.fileno()

    def has_ended(self) -> bool:
        """Return whether it has ended. Raises `SandboxInterruptedError` if the server lost it or never started it."""
        with suppress(BlockingIOError):
            while self._status is None:
                self._listen(socket.MSG_DONTWAIT)
        if self.begun_s is None and time.monotonic() - self._asked_s > WARMED_WITHIN_S:
            raise SandboxInterruptedError(f"did not start within {WARMED_WITHIN_S:g} s: check the fork server")
        return self._status is not None

    def reap(self) -> int:
        """Return the wait status, ending the child first if it still runs."""
        if self._status is None:
            self._told.shutdown(socket.SHUT_WR)
        while self._status is None:
            self._listen(0)
        return self._status

    def close(self) -> None:
        """End the child and remove everything of it."""
        with self._told, suppress(SandboxInterruptedError):
            self.reap()

    def _listen(self, flags: int) -> None:
        try:
            message = self._told.recv(FATE.size, flags)
        except ConnectionError:
            message = b""
        if len(message) == FORKED.size:
            self.begun_s, self._pid = time.monotonic(), FORKED.unpack(message)[1]
        elif len(message) == FATE.size:
            _, self._status, user_s, system_s, peak_bytes = FATE.unpack(message)
            self._note(user_s + system_s, peak_bytes)
        else:
            raise SandboxInterruptedError("was lost with its fork server (out of memory?)")

    def note_usage(self) -> ProcessUsage:
        """Record the usage of the running child so far."""
        used = usage_of(self._pid)
        self._note(used.cpu_s, used.peak_bytes)
        return used

    def _note(self, used_s: float, peak_bytes: int) -> None:
        note_served(max(used_s - self._noted_s, 0.0), peak_bytes)
        self._noted_s = max(used_s, self._noted_s)


def harmless(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the harmless part of an environment, for the fork server."""
    return {name: value for name, value in environment.items() if name in PASSED or name.startswith(PASSED_BEGINNINGS)}


def _start(warmed_by: Sequence[str]) -> tuple[subprocess.Popen[bytes], socket.socket]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, "-P", "-c", PROGRAM, str(theirs.fileno()), *warmed_by]
    with theirs:
        process = subprocess.Popen(
            command, env=harmless(os.environ), cwd="/", stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()]
        )
    return process, ours
