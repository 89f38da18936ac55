"""Memory and processor time of a running platform by process, sampled during another activity."""

import threading
import time
from collections import defaultdict

import psutil

from services.runtime.embedded.supervisor import RunningPlatform

LOOK_S = 2.0


class MemoryWatch:
    """The memory of the platform's processes by program, including descendants, sampled by a thread every 2 s.

    `used_s` are CPU seconds, including ended children; `looked_s` are the sample times on the monotonic clock.
    """

    def __init__(self, running: RunningPlatform) -> None:
        self.held: dict[str, list[int]] = defaultdict(list)
        self.used_s: dict[str, list[float]] = defaultdict(list)
        self.looked_s: list[float] = []
        self._pids = {child.program.name: child.pid for child in running.children}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, name="watch")

    def __enter__(self) -> "MemoryWatch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._over.wait(LOOK_S):
            self.looked_s.append(time.perf_counter())
            for name, pid in self._pids.items():
                processes = [psutil.Process(pid), *_below(pid)]
                self.held[name].append(sum(map(_held_bytes, processes)))
                self.used_s[name].append(sum(map(_used_s, processes)))


def _below(pid: int) -> list[psutil.Process]:
    return list(psutil.Process(pid).children(recursive=True))


def _held_bytes(process: psutil.Process) -> int:
    """Return the process's share of memory (PSS), which counts memory shared after a fork once."""
    try:
        return int(process.memory_full_info().pss)
    except psutil.Error:
        return 0


def _used_s(process: psutil.Process) -> float:
    """Return the process's CPU seconds, including ended children."""
    try:
        return float(sum(process.cpu_times()[:4]))
    except psutil.Error:
        return 0.0
