"""A supervised child process: started, restarted when it dies, stopped in bounded time.

**Conventions.** A child leads its own process group, so Ctrl-C at the terminal reaches only the supervisor. The kernel
kills the child when the supervisor dies. `stop` sends SIGTERM; the rest of the group is killed.
"""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from services.runtime.processes.parent_death import die_with

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 30.0
STEADY_S = 30.0

ReportCallback = Callable[[str], None]


@dataclass(frozen=True)
class Program:
    """The command of a child.

    - `stop_s`: the time it may take to stop
    - `passed`: descriptors it inherits
    - `niceness`: lower CPU priority of the child and its descendants
    """

    name: str
    argv: tuple[str, ...]
    environment: Mapping[str, str]
    folder: Path
    stop_s: float
    passed: tuple[int, ...] = ()
    niceness: int = 0


class Child:
    """A program that is kept running. Used by one thread at a time."""

    def __init__(self, program: Program, logs: Path, report: ReportCallback) -> None:
        self.program = program
        self.log = logs / f"{program.name}.log"
        self._report = report
        self._process: subprocess.Popen[bytes] | None = None
        self._pause_s = FIRST_PAUSE_S
        self._started_s = self._due_s = 0.0
        self._is_asked = False

    @property
    def pid(self) -> int:
        """The id of the running or last process; 0 before the first."""
        return self._process.pid if self._process else 0

    @property
    def exit_code(self) -> int | None:
        """The last exit code; None while it runs, or before its start."""
        return self._process.poll() if self._process else None

    def start(self) -> None:
        """Start it, appending to its log. The calling thread must outlive the child."""
        own_pid = os.getpid()
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                self.program.argv,
                cwd=self.program.folder,
                env=dict(self.program.environment),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=self.program.passed,
                process_group=0,
                preexec_fn=lambda: _begin(own_pid, self.program.niceness),
            )
        self._started_s, self._due_s, self._is_asked = time.monotonic(), 0.0, False

    def revive(self) -> None:
        """Restart it if it died, after a pause that doubles while it keeps dying; truncate its log if large."""
        cut_if_large(self.log)
        now_s = time.monotonic()
        if self.exit_code is None:
            return
        if not self._due_s:
            self._kill_group()
            if now_s - self._started_s > STEADY_S:
                self._pause_s = FIRST_PAUSE_S
            self._due_s = now_s + self._pause_s
            fate = f"{self.program.name} {fate_of(self.exit_code)}; it is restarted in {self._pause_s:g} s"
            self._report(f"{fate} (log: {self.log})")
            self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        elif now_s >= self._due_s:
            self.start()
            self._report(f"{self.program.name} was restarted, process {self.pid}")

    def forgive(self) -> None:
        """Reset the pause, because its next death is deliberate, for example in a test."""
        self._pause_s = FIRST_PAUSE_S

    def ask_to_stop(self) -> None:
        """Send SIGTERM, once, to the child itself, which stops its own children."""
        if self._process and self.exit_code is None and not self._is_asked:
            self._is_asked = True
            self._process.terminate()

    def stop(self, within_s: float | None = None) -> bool:
        """Stop it within `within_s` (default: its own time), then kill the rest; return whether it ended itself."""
        if self._process is None:
            return True
        self.ask_to_stop()
        try:
            self._process.wait(self.program.stop_s if within_s is None else max(within_s, 0.0))
        except subprocess.TimeoutExpired:
            return False
        finally:
            self._kill_group()
            self._process.wait()
        return True

    def kill(self) -> None:
        """End the child and everything in its group at once."""
        if self._process:
            self._kill_group()
            self._process.wait()

    def _kill_group(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)


def _begin(supervisor_pid: int, niceness: int) -> None:
    """Prepare the child process before its program starts."""
    die_with(supervisor_pid)
    os.nice(niceness)


def fate_of(exit_code: int) -> str:
    """Return `ended with exit code 3`, `was killed by SIGKILL`."""
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    return f"was killed by {signal.Signals(-exit_code).name}"


# Log files of the child processes, truncated by size by the supervisor (copy and truncate). The child continues writing
# to the same open file (`O_APPEND`), so it needs no signal and no pipe that could fill up. A line written between copy
# and truncation may be lost; job logs are in the database.


MAX_BYTES = 16 * 2**20
KEPT = 3


def cut_if_large(log: Path, max_bytes: int = MAX_BYTES) -> bool:
    """Move the content of `log` to `<log>.1` if it exceeds `max_bytes`; older files move up, the oldest is deleted."""
    if not log.exists() or log.stat().st_size <= max_bytes:
        return False
    for number in range(KEPT - 1, 0, -1):
        older = _numbered(log, number)
        if older.exists():
            older.replace(_numbered(log, number + 1))
    shutil.copyfile(log, _numbered(log, 1))
    with log.open("r+b") as file:
        file.truncate(0)
    return True


def last_words(log: Path, max_bytes: int = 2000) -> str:
    """Return the last non-empty line of `log`, or ""."""
    if not log.exists():
        return ""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - max_bytes))
        lines = file.read().decode("utf-8", "replace").splitlines()
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _numbered(log: Path, number: int) -> Path:
    return log.with_name(f"{log.name}.{number}")
