"""The cost of each test: `pytest --costs FILE` writes its CPU seconds and the memory of the process after it.

**Conventions.** CPU seconds are those of the test process and all its children, so other load on the machine changes
them little. The setup of a test includes the cost of shared fixtures that it is the first to use. Each test has one
tab-separated line (`COLUMNS`), appended, so that the processes of `pytest-xdist` may share a file. The end lists tests
that cost more than `DEAR_CPU_S`.
"""

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

COLUMNS = ("cpu_s", "setup_cpu_s", "wall_s", "resident_mb", "test")
DEAR_CPU_S = 5.0
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--costs", metavar="FILE", type=Path, help="write what each test costs to this file")


def pytest_configure(config: pytest.Config) -> None:
    path: Path | None = config.getoption("--costs")
    if path is not None:
        config.pluginmanager.register(Costs(path.absolute()), "costs")


@dataclass(eq=False)  # pytest stores plugins in sets
class Costs:
    """A plugin that measures every test and appends its cost to the file at `path`."""

    path: Path
    _setup_cpu_s: float = field(default=0.0)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        before_cpu_s, before_s = tree_cpu_s(), time.monotonic()
        try:
            return (yield)
        finally:
            # Children without a waiting parent are forgotten: a test in which a browser ends would have negative cost.
            used_cpu_s, passed_s = tree_cpu_s() - before_cpu_s, time.monotonic() - before_s
            self._write(max(0.0, used_cpu_s), self._setup_cpu_s, passed_s, resident_mb(), item.nodeid)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        before_cpu_s = tree_cpu_s()
        try:
            return (yield)
        finally:
            self._setup_cpu_s = tree_cpu_s() - before_cpu_s

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        lines = [line.split("\t") for line in self.path.read_text("utf-8").splitlines()]
        dear = sorted((line for line in lines if float(line[0]) > DEAR_CPU_S), key=lambda line: -float(line[0]))
        terminalreporter.section(f"more than {DEAR_CPU_S:g} CPU seconds")
        for line in [COLUMNS, *dear]:
            terminalreporter.write_line("  ".join(f"{word:>11}" for word in line))

    def _write(self, *values: float | str) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write("\t".join(value if isinstance(value, str) else f"{value:.2f}" for value in values) + "\n")


def tree_cpu_s() -> float:
    """Return user and system time of this process, its living descendants, and its reaped children."""
    parent_of, ticks_of = _processes()
    below = [os.getpid()]
    for pid in below:
        below += [child for child, parent in parent_of.items() if parent == pid]
    return sum(ticks_of[pid] for pid in below) / TICKS_PER_S


def _processes() -> tuple[dict[int, int], dict[int, int]]:
    """Return the parent of every process, and its ticks including reaped children."""
    parent_of, ticks_of = {}, {}
    for folder in Path("/proc").iterdir():
        with suppress(ValueError, OSError):  # not a process, or ended meanwhile
            pid = int(folder.name)
            fields = (folder / "stat").read_text("utf-8", "replace").rpartition(")")[2].split()
            parent_of[pid], ticks_of[pid] = int(fields[1]), sum(int(number) for number in fields[11:15])
    return parent_of, ticks_of


def resident_mb() -> float:
    """Return the memory of this process, in units of 2^20 bytes."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20
