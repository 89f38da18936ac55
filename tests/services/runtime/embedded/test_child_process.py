"""A child is kept running, ends in bounded time, and never outlives the process that started it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from services.runtime.embedded.child_process import Child, Program
from testing.process_states import is_running

PATIENCE_S = 300.0
FORKS = "import os, time; os.fork(); time.sleep(600)"
STUBBORN = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('deaf', flush=True); time.sleep(600)"
)
SUPERVISOR = """
import sys, time
from pathlib import Path
from services.runtime.embedded.child_process import Child, Program
import os
child = Child(Program("sleeper", ("sleep", "600"), os.environ, Path(sys.argv[1]), 1.0), Path(sys.argv[1]), print)
child.start()
print(child.pid, flush=True)
time.sleep(600)
"""


def until(claim: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not claim():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.02)


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def make(tmp_path: Path, told: list[str]) -> Iterator[Callable[..., Child]]:
    made: list[Child] = []

    def child(*argv: str, stop_s: float = 5.0) -> Child:
        made.append(Child(Program("sleeper", argv, os.environ, tmp_path, stop_s), tmp_path / "logs", told.append))
        return made[-1]

    yield child
    for each in made:
        each.kill()


def test_a_child_that_stands_back_leaves_processors_to_others(tmp_path: Path, told: list[str]) -> None:
    program = Program("sleeper", ("sleep", "600"), os.environ, tmp_path, 5.0, niceness=3)
    child = Child(program, tmp_path / "logs", told.append)
    child.start()
    try:
        assert psutil.Process(child.pid).nice() == psutil.Process().nice() + 3
    finally:
        child.kill()


def test_a_dead_child_is_started_again_after_a_pause_and_it_is_said(
    make: Callable[..., Child], told: list[str]
) -> None:
    child = make("sleep", "600")
    child.start()
    first = child.pid
    os.kill(first, signal.SIGKILL)
    until(lambda: child.exit_code is not None)
    child.revive()
    assert child.pid == first, "not at once"
    until(lambda: child.revive() or child.pid != first)
    assert is_running(child.pid)
    assert "sleeper was killed by SIGKILL; starting it again in 0.5 s" in told[0]
    assert "started again" in told[1]


def test_a_child_that_keeps_dying_is_started_ever_more_rarely(make: Callable[..., Child], told: list[str]) -> None:
    child = make("false")
    child.start()
    until(lambda: child.revive() or sum("ended with exit code 1" in line for line in told) == 3)
    pauses = [line.partition(" again in ")[2].partition(" s")[0] for line in told if "ended" in line]
    assert pauses == ["0.5", "1", "2"]


def test_stopping_ends_what_the_child_forked_too(make: Callable[..., Child]) -> None:
    child = make(sys.executable, "-c", FORKS)
    child.start()
    until(lambda: len(psutil.Process(child.pid).children()) == 1)
    grandchild = psutil.Process(child.pid).children()[0].pid
    assert child.stop()
    until(lambda: not is_running(grandchild))


def test_a_child_that_does_not_listen_is_killed_when_its_time_is_up(make: Callable[..., Child]) -> None:
    child = make(sys.executable, "-c", STUBBORN, stop_s=0.2)
    child.start()
    until(lambda: "deaf" in child.log.read_text())
    assert not child.stop()
    assert child.exit_code == -signal.SIGKILL


def test_a_child_dies_with_its_supervisor_even_by_kill_9(tmp_path: Path) -> None:
    supervisor = subprocess.Popen([sys.executable, "-c", SUPERVISOR, tmp_path], stdout=subprocess.PIPE, text=True)
    assert supervisor.stdout is not None
    with supervisor.stdout:
        pid = int(supervisor.stdout.readline())
    assert is_running(pid)
    supervisor.kill()
    supervisor.wait()
    until(lambda: not is_running(pid))


def test_a_log_is_appended_to_across_starts(make: Callable[..., Child]) -> None:
    child = make("echo", "here")
    for _ in range(2):
        child.start()
        until(lambda: child.exit_code is not None)
    assert child.log.read_text() == "here\nhere\n"
