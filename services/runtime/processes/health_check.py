"""The container health check: exit code 0 when healthy, else 1 and the reason.

    python -m services.runtime.processes.health_check              every process of this container that beats has beaten
    lately python -m services.runtime.processes.health_check 900          … within so many seconds
    python -m services.runtime.processes.health_check http://…     what answers there answers with success

**Conventions.** Of workers and sweeper it is not asked whether database and broker answer: starting them anew repairs
neither. Standard library only: it is run every half a minute.
"""

import os
import re
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.request import ProxyHandler, build_opener

# Heartbeat files: touched by a live process, read by its health probe.
#
# **Conventions.** `<data folder>/alive/<host>.<pid>.<ticks>`, the ticks being when the process was started (proc(5)),
# so that neither another container on the same volume nor a pid that came round again is mistaken for it. A process of
# several parts that go on by themselves has a file for each, `….<part>`. Standard library only: a probe is run every
# few seconds. A disk that is full or gone does not end what beats.


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


WITHIN_S = 120.0
ANSWER_S = 10.0


def silence(found: list[LiveProcess], within_s: float) -> str:
    """The processes that beat too long ago, in words; empty when all beat."""
    if not found:
        return "no process of this container has sent a heartbeat"
    late = [f"{_name_of(one)}: last heartbeat {one.age_s:.0f} s ago" for one in found if one.age_s > within_s]
    return "; ".join(late)


def _name_of(one: LiveProcess) -> str:
    return f"{one.part} of process {one.pid}" if one.part else f"process {one.pid}"


def refusal(url: str) -> str:
    """Why `url` gave no success; empty when it did. Asked directly, whatever proxy the environment names."""
    try:
        with build_opener(ProxyHandler({})).open(url, timeout=ANSWER_S):
            return ""
    except OSError as error:  # HTTPError is one
        return f"{url}: {error}"


def main() -> None:
    asked = sys.argv[1] if len(sys.argv) > 1 else str(WITHIN_S)
    if asked.startswith("http:"):
        wrong = refusal(asked)
    else:
        root = Path(os.environ.get("STONE_DATA_FOLDER", "stone-data")).expanduser()
        wrong = silence(live_processes(root), float(asked))
    if wrong:
        sys.exit(wrong)


if __name__ == "__main__":
    main()
