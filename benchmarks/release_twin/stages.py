"""The cost of each measured stage, in this process and all below it.

**Conventions.** Processor seconds cover the whole tree, including ended processes. Memory is the resident memory of
single processes, sampled by a thread. Stored bytes are those of the data folder, each file once.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from time import perf_counter

import psutil

from benchmarks.release_import.run import GONE, LOOK_S, MIB, ROLES


@dataclass(frozen=True)
class StageCost:
    """A stage; `busiest` names the process with the most memory, and `load` is the machine's load at its end."""

    name: str
    frames: int
    wall_s: float
    cpu_s: float
    most_mib: float
    busiest: str
    stored_bytes: int
    load: float

    def __str__(self) -> str:
        rate = f"{self.frames / self.wall_s:7.0f} {self.frames / self.cpu_s:8.0f}" if self.frames else " " * 16
        spent = f"{self.wall_s:8.1f} {self.cpu_s:8.1f}"
        held = f"{self.most_mib:6.0f} {self.busiest:18} {self.stored_bytes / 1e6:9.1f}"
        return f"{self.name:34} {self.frames:7} {spent} {rate} {held} {self.load:5.1f}"


HEAD = (
    f"{'stage':34} {'frames':>7} {'s':>8} {'CPU s':>8} {'1/s':>7} {'1/CPU s':>8} {'MiB':>6} "
    f"{'busiest process':18} {'stored MB':>9} {'load':>5}"
)


@contextmanager
def stage(name: str, frames: int, data: Path) -> Iterator[None]:
    """Measure the block and print its cost."""
    most_mib, ended = dict[str, float](), Event()
    thread = Thread(target=_look, args=(most_mib, ended), daemon=True)
    thread.start()
    begun, before_s = perf_counter(), _tree_cpu_s()
    try:
        yield
    finally:
        wall_s, cpu_s = perf_counter() - begun, max(_tree_cpu_s() - before_s, 0.01)
        ended.set()
        thread.join()
    busiest = max(most_mib, key=most_mib.__getitem__, default="")
    held = (most_mib.get(busiest, 0.0), busiest, _stored_bytes(data), os.getloadavg()[0])
    print(StageCost(name, frames, wall_s, cpu_s, *held), flush=True)


def _look(most_mib: dict[str, float], ended: Event) -> None:
    while True:
        for process in psutil.Process().children(recursive=True):
            with suppress(*GONE):
                role = _role(process.cmdline())
                most_mib[role] = max(most_mib.get(role, 0.0), process.memory_info().rss / MIB)
        if ended.wait(LOOK_S):
            return


def _role(words: list[str]) -> str:
    """Return the role of a process: its module, a worker of a pool, or its first words."""
    line = " ".join(words)
    if "multiprocessing" in line:
        return "a pool's worker"
    of_module = words[words.index("-m") + 1].rpartition(".")[2] if "-m" in words[:-1] else ""
    first = " ".join(words[1:3]).rpartition("/")[2]
    return next((role for role in ROLES if role in line), of_module or first)


def _tree_cpu_s() -> float:
    total = sum(os.times()[:4])
    for process in psutil.Process().children(recursive=True):
        with suppress(*GONE):
            total += sum(process.cpu_times()[:4])
    return total


def _stored_bytes(folder: Path) -> int:
    sizes = dict[tuple[int, int], int]()
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                stat = os.lstat(os.path.join(parent, name))
                sizes[stat.st_dev, stat.st_ino] = stat.st_size
    return sum(sizes.values())
