"""Resource usage of this process, its children and its fork server's children; free memory and disk of the machine.

**Conventions.** The values come from Linux: `/proc` (proc(5)) and, in a container, `/sys/fs/cgroup` (cgroup v2).
Unreadable values are None.
"""

import os
import re
import resource
import shutil
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

OURS = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
PROC, CGROUP = Path("/proc"), Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Room:
    """Free bytes and total bytes."""

    free_bytes: int | None = None
    total_bytes: int | None = None


@dataclass(frozen=True)
class ProcessUsage:
    """Processor time (user and system), and the current and highest resident memory of a process in bytes."""

    cpu_s: float = 0.0
    held_bytes: int = 0
    peak_bytes: int = 0


@dataclass
class _ServedUsage:
    """Usage of the fork server's children that worked for this process."""

    cpu_s: float = 0.0
    peak_bytes: int = 0


_SERVED, _SERVED_LOCK = _ServedUsage(), Lock()


def note_served(cpu_s: float, peak_bytes: int) -> None:
    """Add the usage of an ended child of a fork server that worked for this process."""
    with _SERVED_LOCK:
        _SERVED.cpu_s += cpu_s
        _SERVED.peak_bytes = max(_SERVED.peak_bytes, peak_bytes)


def used_cpu_s() -> float:
    """Return the processor time, user and system, in seconds."""
    used = [resource.getrusage(who) for who in OURS]
    return sum(usage.ru_utime + usage.ru_stime for usage in used) + _SERVED.cpu_s


def peak_bytes() -> int:
    """Return the highest memory of any single process among them."""
    return max(_SERVED.peak_bytes, *(resource.getrusage(who).ru_maxrss * 1024 for who in OURS))


def usage_of(pid: int, proc: Path = PROC) -> ProcessUsage:
    """Return the usage of another process; zeros if it has ended."""
    try:
        fields = (proc / str(pid) / "stat").read_text().rpartition(")")[2].split()
        status = (proc / str(pid) / "status").read_text()
    except OSError:
        return ProcessUsage()
    sizes = {name: int(kib) * 1024 for name, kib in re.findall(r"^(VmHWM|VmRSS):\s+(\d+) kB$", status, re.MULTILINE)}
    cpu_s = sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    return ProcessUsage(cpu_s, sizes.get("VmRSS", 0), sizes.get("VmHWM", 0))


def held_bytes(proc: Path = PROC) -> int | None:
    """Return the current memory of this process (resident set)."""
    try:
        return int((proc / "self" / "statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return None


def memory(proc: Path = PROC, cgroup: Path = CGROUP) -> Room:
    """Return the machine's memory, or the container's if its limit is lower."""
    of_machine = _machine_memory(proc)
    try:
        limit, used = (int((cgroup / name).read_text("ascii")) for name in ("memory.max", "memory.current"))
    except (OSError, ValueError):  # not a container, or no limit: "max"
        return of_machine
    if of_machine.total_bytes is not None and limit >= of_machine.total_bytes:
        return of_machine
    left = max(limit - used, 0)
    return Room(left if of_machine.free_bytes is None else min(left, of_machine.free_bytes), limit)


def disk(folder: Path) -> Room:
    """Return the space on the disk of the folder, which need not exist yet."""
    try:
        usage = shutil.disk_usage(next(path for path in (folder, *folder.parents) if path.exists()))
    except OSError:
        return Room()
    return Room(usage.free, usage.total)


def _machine_memory(proc: Path) -> Room:
    try:
        lines = (proc / "meminfo").read_text("ascii")
    except (OSError, ValueError):
        return Room()
    sizes = {name: int(kib) * 1024 for name, kib in re.findall(r"^(\w+):\s+(\d+) kB$", lines, re.MULTILINE)}
    return Room(sizes.get("MemAvailable"), sizes.get("MemTotal"))
