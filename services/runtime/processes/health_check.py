"""The container health check: exit code 0 when healthy, else 1 and the reason.

    python -m services.runtime.processes.health_check              each process of this container had a recent heartbeat
    python -m services.runtime.processes.health_check 900          … within this many seconds
    python -m services.runtime.processes.health_check http://…     a request to this URL succeeds

**Conventions.** For workers and sweeper, the check ignores database and broker: restarting the processes would repair
neither. Standard library only: it runs every half minute.
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
# **Conventions.** The name is `<data folder>/alive/<host>.<pid>.<ticks>`; the ticks are the start time of the process
# (proc(5)). They distinguish it from other containers on the same volume and from a reused pid. A process with several
# independent parts has a file for each, `….<part>`. Standard library only: a probe runs every few seconds. A full or
# missing disk does not end the process.


FOLDER = "alive"
_START = 19
"""The index of the start time among the words after the process's name in /proc/<pid>/stat."""


@dataclass(frozen=True)
class LiveProcess:
    """A living process of this host, or a part of it, and the age of its heartbeat."""

    pid: int
    age_s: float
    part: str = ""


class HeartbeatFile:
    """The heartbeat of this process or of its `part` (a word): call `beat()` regularly and `stop()` at the end."""

    def __init__(self, root: Path, part: str = "") -> None:
        self._folder = root / FOLDER
        self._end = f".{part}" if part else ""

    def beat(self) -> None:
        """Touch the file."""
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._path.touch()

    def stop(self) -> None:
        """Delete the file: the process is no longer expected."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    @property
    def _path(self) -> Path:
        return self._folder / f"{socket.gethostname()}.{os.getpid()}.{_start_ticks(os.getpid())}{self._end}"


def live_processes(root: Path) -> list[LiveProcess]:
    """Return every living process of this host with a heartbeat; delete the files of ended processes."""
    processes = []
    ours = re.compile(rf"{re.escape(socket.gethostname())}\.(\d+)\.(\d+)(?:\.([a-z]+))?")
    for path in sorted((root / FOLDER).glob("*")):
        if (match := ours.fullmatch(path.name)) is None:
            continue
        pid, ticks, part = match.groups(default="")
        if _start_ticks(int(pid)) != ticks:
            path.unlink(missing_ok=True)
            continue
        with suppress(FileNotFoundError):
            processes.append(LiveProcess(int(pid), max(0.0, time.time() - path.stat().st_mtime), part))
    return processes


def _start_ticks(pid: int) -> str:
    """Return the start time of a process in clock ticks since boot; empty if it does not exist."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[_START]
    except (OSError, IndexError):
        return ""


WITHIN_S = 120.0
ANSWER_S = 10.0


def silence(processes: list[LiveProcess], within_s: float) -> str:
    """Return the processes whose heartbeat is too old, in words; empty if there are none."""
    if not processes:
        return "no process of this container has sent a heartbeat"
    late = [
        f"{_name_of(process)}: last heartbeat {process.age_s:.0f} s ago"
        for process in processes
        if process.age_s > within_s
    ]
    return "; ".join(late)


def _name_of(process: LiveProcess) -> str:
    return f"{process.part} of process {process.pid}" if process.part else f"process {process.pid}"


def refusal(url: str) -> str:
    """Return why `url` did not return success, or an empty text. The request ignores proxies of the environment."""
    try:
        with build_opener(ProxyHandler({})).open(url, timeout=ANSWER_S):
            return ""
    except OSError as error:
        return f"{url}: {error}"


def main() -> None:
    target = sys.argv[1] if len(sys.argv) > 1 else str(WITHIN_S)
    if target.startswith("http:"):
        wrong = refusal(target)
    else:
        root = Path(os.environ.get("STONE_DATA_FOLDER", "stone-data")).expanduser()
        wrong = silence(live_processes(root), float(target))
    if wrong:
        sys.exit(wrong)


if __name__ == "__main__":
    main()
