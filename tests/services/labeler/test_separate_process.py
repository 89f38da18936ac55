"""A function in a process of its own: its answer, its refusal, its end; and what goes on beside it."""

import ctypes
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import numpy as np
import psutil
import pytest

from services.labeler.map.octree import reconstruct
from services.labeler.separate_process import ChildEndedError, apart
from testing.signals import hear_signals

PATIENCE_S = 300.0
CALLER = """
import os, sys, time
from pathlib import Path
from services.labeler.separate_process import apart

def hang(told):
    Path(told).write_text(str(os.getpid()))
    time.sleep(60)

apart(hang, sys.argv[1])
"""


def doubled(values: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return values * 2


def refuse() -> None:
    raise ValueError("not today")


def kill_oneself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def is_answered_meanwhile(asking: str, answers: str, seconds: float) -> bool:
    """Whether a question is answered while native code never gives the interpreter's lock back, as `PyDLL` does not."""
    library = ctypes.PyDLL(None)
    asked, answer = os.open(asking, os.O_RDWR), os.open(answers, os.O_RDWR)
    awaited = (ctypes.c_int * 2)(answer, select.POLLIN)
    library.write(asked, b"?", 1)
    return bool(library.poll(awaited, 1, int(seconds * 1e3)) == 1)


@contextmanager
def answering(folder: Path) -> Iterator[tuple[str, str]]:
    """Two pipes; a thread of this process answers on the second what is asked on the first."""
    asking, answers = folder / "asking", folder / "answers"
    os.mkfifo(asking)
    os.mkfifo(answers)
    asked, answer = os.open(asking, os.O_RDWR), os.open(answers, os.O_RDWR)
    thread = Thread(target=lambda: os.write(answer, os.read(asked, 1)))
    thread.start()
    try:
        yield str(asking), str(answers)
    finally:
        os.write(asked, b"?")  # whoever still waits for a question
        thread.join()
        os.close(asked)
        os.close(answer)


def longest_pause_s(act: Callable[[], object]) -> float:
    """How long a thread beside `act` was kept from going on at most."""
    beats, is_over = [time.monotonic()], Event()

    def beat() -> None:
        while not is_over.is_set():
            beats.append(time.monotonic())
            time.sleep(0.01)

    thread = Thread(target=beat)
    thread.start()
    try:
        act()
    finally:
        is_over.set()
        thread.join()
    return float(np.diff([*beats, time.monotonic()]).max())


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def await_true(is_true: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not is_true():
        assert time.monotonic() < until_s
        time.sleep(0.02)


def test_the_answer_comes_back_whatever_its_size() -> None:
    values = np.arange(2_000_000.0)
    assert np.array_equal(apart(doubled, values), values * 2)


def test_what_it_raises_is_raised_here() -> None:
    with pytest.raises(ValueError, match="not today"):
        apart(refuse)


def zombies() -> set[int]:
    """Children of this process that ended and were not waited for; other tests may have left some."""
    return {child.pid for child in psutil.Process().children() if not is_alive(child.pid)}


def test_a_killed_process_is_told_with_its_signal_and_no_zombie_stays() -> None:
    others = {child.pid for child in psutil.Process().children()}
    with pytest.raises(ChildEndedError, match="kill_oneself was killed by SIGKILL without an answer"):
        apart(kill_oneself)
    assert zombies() <= others


@pytest.fixture
def threads_take_no_turns() -> Iterator[None]:
    """A thread that is not asked for the interpreter's lock by a call of its own keeps it."""
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(1000.0)
    yield
    sys.setswitchinterval(usual_s)


def test_the_stand_in_keeps_the_interpreter(tmp_path: Path, threads_take_no_turns: None) -> None:
    with answering(tmp_path) as pipes:
        assert not is_answered_meanwhile(*pipes, 0.5), "the stand-in does not keep the interpreter's lock"


def test_other_threads_go_on_while_it_keeps_the_interpreter(tmp_path: Path) -> None:
    with answering(tmp_path) as pipes:
        assert apart(is_answered_meanwhile, *pipes, PATIENCE_S)


def test_heartbeats_go_on_while_the_solver_works() -> None:
    chance = np.random.default_rng(1)
    points = np.column_stack([chance.uniform(0.0, 25.0, (60_000, 2)), chance.uniform(4.0, 4.1, 60_000)])
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    begun_s = time.monotonic()
    pause_s = longest_pause_s(lambda: reconstruct(points, normals, np.zeros(3), (128, 0.2)))
    assert pause_s < 0.5 * (time.monotonic() - begun_s)


def test_it_ends_with_the_process_that_asked(tmp_path: Path) -> None:
    told = tmp_path / "pid"
    asker = subprocess.Popen([sys.executable, "-c", CALLER, str(told)], cwd=Path(__file__).parents[3])
    try:
        await_true(lambda: told.exists() and told.read_text() != "")
        pid = int(told.read_text())
        assert is_alive(pid)
    finally:
        asker.kill()
        asker.wait()
    await_true(lambda: not is_alive(pid))


def test_it_ends_when_the_wait_for_it_is_interrupted(tmp_path: Path) -> None:
    told = tmp_path / "pid"
    asker = subprocess.Popen(
        [sys.executable, "-c", CALLER, str(told)],
        cwd=Path(__file__).parents[3],
        stderr=subprocess.PIPE,
        preexec_fn=hear_signals,
    )
    await_true(lambda: told.exists() and told.read_text() != "")
    asker.send_signal(signal.SIGINT)
    assert b"KeyboardInterrupt" in asker.communicate(timeout=PATIENCE_S)[1]
    await_true(lambda: not is_alive(int(told.read_text())))
