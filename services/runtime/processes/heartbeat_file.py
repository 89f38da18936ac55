"""Heartbeat files: touched by a live process, read by its health probe.

**Conventions.** `<data folder>/alive/<host>.<pid>.<ticks>`, the ticks being when the process was started (proc(5)), so
that neither another container on the same volume nor a pid that came round again is mistaken for it. A process of
several parts that go on by themselves has a file for each, `….<part>`. Standard library
only: a probe is run every few seconds. A disk that is full or gone does not end what beats.
"""

import os
import re
import socket
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

FOLDER = "alive"
_START = 19
"""Which word of /proc/<pid>/stat after the process's name is its start."""


@dataclass(frozen=True)
class LiveProcess:
    """A living process of this host, or a part of one, and how long ago it beat."""

    pid: int
    age_s: float
    part: str = ""


class HeartbeatFile:
    """`beat()` now and then, `stop()` at the end; of the process that calls, or of its `part`, a word."""

    def __init__(self, root: Path, part: str = "") -> None:
        self._folder = root / FOLDER
        self._end = f".{part}" if part else ""

    def beat(self) -> None:
        """Say that this process lives."""
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._path.touch()

    def stop(self) -> None:
        """Be missed no more."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    @property
    def _path(self) -> Path:
        return self._folder / f"{socket.gethostname()}.{os.getpid()}.{_started(os.getpid())}{self._end}"


def live_processes(root: Path) -> list[LiveProcess]:
    """Every process of this host that beat and still lives; the files of those that ended are removed."""
    found = []
    ours = re.compile(rf"{re.escape(socket.gethostname())}\.(\d+)\.(\d+)(?:\.([a-z]+))?")
    for path in sorted((root / FOLDER).glob("*")):
        if (match := ours.fullmatch(path.name)) is None:
            continue
        pid, ticks, part = match.groups(default="")
        if _started(int(pid)) != ticks:
            path.unlink(missing_ok=True)
            continue
        with suppress(FileNotFoundError):
            found.append(LiveProcess(int(pid), max(0.0, time.time() - path.stat().st_mtime), part))
    return found


def _started(pid: int) -> str:
    """When the process was started, in clock ticks since boot; empty where there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[_START]
    except (OSError, IndexError):
        return ""
