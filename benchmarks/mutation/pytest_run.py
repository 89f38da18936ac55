"""One run of pytest on some test files, in processes of its own, stopped when it has used up its processor time.

**Conventions.** Time is processor time of the whole process tree, so that another load on the machine changes no
verdict. A run that hardly computes for long stands still, and is stopped too. Exit codes 1 and 2 of pytest are
failures, 5 is a file without tests.
"""

import contextlib
import os
import re
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import psutil  # type: ignore[import-untyped,unused-ignore]

from benchmarks.mutation.forking import Forked, fork_pytest

POLL_S, STILL_S, GRACE_S, WALL_S = 0.25, 150.0, 15.0, 1800.0
STILL_CPU_S = 0.5
OPTIONS = (
    *("-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider", "--hypothesis-seed=16"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of plugins that were loaded before the fork
)
NO_TESTS = 5
FAILED_LINE = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
Outcome = Literal["passed", "failed", "out of time", "stood still"]


@dataclass(frozen=True)
class TestRun:
    """How test files went, the processor seconds it took, and the first test that failed."""

    __test__ = False

    outcome: Outcome
    cpu_s: float
    failed: str = ""


def run_tests(root: Path, tests: Sequence[str], cpu_limit_s: float, cache: Path) -> TestRun:
    """The tests of some files of the tree at `root`, up to the first that fails; compiled code is kept in `cache`."""
    environment = {
        **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
        "PYTHONPATH": str(root),
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPYCACHEPREFIX": str(cache / "bytecode"),
    }
    arguments = [*OPTIONS, *tests]
    process = fork_pytest(root, arguments, environment, cache / "said.txt")
    try:
        outcome, cpu_s, family = _watch(process, cpu_limit_s)
    except BaseException:
        _stop(process, _family(process.pid))
        raise
    if outcome:
        _stop(process, family)
    said = process.said() if not outcome else ""
    if outcome is None:
        outcome = "passed" if process.returncode in (0, NO_TESTS) else "failed"
    found = FAILED_LINE.search(said)
    return TestRun(outcome, round(cpu_s, 1), (found[1] if found else said[-300:]) if outcome == "failed" else "")


def _watch(process: Forked, cpu_limit_s: float) -> tuple[Outcome | None, float, list[psutil.Process]]:
    """Why the run must be stopped, None where it ended by itself; its processor time; the processes seen at the end."""
    begun = since = time.monotonic()
    cpu_s = then_s = 0.0
    family: list[psutil.Process] = []
    while process.poll() is None:
        time.sleep(POLL_S)
        family = _family(process.pid) or family
        cpu_s = max(cpu_s, sum(map(_cpu_s, family)))
        now = time.monotonic()
        if cpu_s - then_s > STILL_CPU_S:
            since, then_s = now, cpu_s
        if cpu_s > cpu_limit_s:
            return "out of time", cpu_s, family
        if now - since > STILL_S or now - begun > WALL_S:
            return "stood still", cpu_s, family
    return None, cpu_s, family


def _family(pid: int) -> list[psutil.Process]:
    with contextlib.suppress(psutil.Error):
        parent = psutil.Process(pid)
        return [parent, *parent.children(recursive=True)]
    return []


def _cpu_s(process: psutil.Process) -> float:
    with contextlib.suppress(psutil.Error):
        times = process.cpu_times()
        return float(times.user + times.system + times.children_user + times.children_system)
    return 0.0


def _stop(process: Forked, family: list[psutil.Process]) -> None:
    """Interrupted, so that servers are ended by who started them; then killed, with all that were seen below it."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process.pid, signal.SIGINT)
    until = time.monotonic() + GRACE_S
    while process.poll() is None and time.monotonic() < until:
        time.sleep(POLL_S)
    for one in family:
        with contextlib.suppress(psutil.Error):
            one.kill()
    while process.poll() is None:
        time.sleep(POLL_S)
