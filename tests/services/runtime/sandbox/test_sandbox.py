"""What goes wrong in the child is a coded error here; nothing of it stays: no process, no zombie, no descriptor."""

import ctypes
import faulthandler
import gc
import mmap
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from services.runtime.sandbox import ProgressCallback, SandboxLimits, SandboxWatch, sandboxed, sandboxed_with_progress
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from stone.errors import PlatformFaultError, Refused, StoneError
from stone_submissions.errors import SubmissionError
from testing.process_states import is_running
from testing.refusals import refused_as
from testing.stone_serve import until
from testing.threads import at_once

Work = Callable[[], bytes]
SMALL = SandboxLimits(memory_bytes=32 * 2**20, cpu_s=1, wall_s=60.0, answer_bytes=1000, descriptors=8)


def held() -> tuple[int, int]:
    """How many descriptors and how many children this process has."""
    tasks = Path("/proc/self/task")
    children = 0
    for task in tasks.iterdir():
        with suppress(FileNotFoundError):  # a thread that ended meanwhile
            children += len((task / "children").read_text().split())
    return len(os.listdir("/proc/self/fd")), children


@pytest.fixture(autouse=True)
def _leaves_nothing() -> Iterator[None]:
    gc.collect()  # an earlier test's garbage would go while this one runs
    before = held()
    yield
    assert held() == before


def killed(number: int) -> bytes:
    os.kill(os.getpid(), number)
    return b""


def asleep(seconds: float = 600.0) -> bytes:
    time.sleep(seconds)
    return b"slow"


def segfault() -> bytes:
    faulthandler.disable()
    return ctypes.string_at(8)


def abort() -> bytes:
    faulthandler.disable()
    os.abort()


def endless() -> bytes:
    while True:
        pass


def memory_hog() -> bytes:
    return bytes(10**9)


def native_memory_hog() -> bytes:
    with mmap.mmap(-1, 10**9):
        return b""


def many_small_allocations() -> bytes:
    return b"".join([os.urandom(1000) for _ in range(100_000)])


def deep() -> bytes:
    return deep()


def key_error() -> bytes:
    return {b"a": b"b"}[b"secret"]


def leave() -> bytes:
    raise SystemExit(0)


CRASHES: dict[str, tuple[Work, str]] = {
    "a fault of memory": (segfault, "SIGSEGV"),
    "abort": (abort, "SIGABRT"),
    "an endless loop": (endless, "1 s of processor"),
    "a GB at once": (memory_hog, "32 MiB"),
    "100 MB by the kB": (many_small_allocations, "32 MiB"),
    "a GB mapped": (native_memory_hog, "OSError"),
    "descriptors": (lambda: bytes(os.dup(0) for _ in range(9)), "OSError"),
    "endless recursion": (deep, "RecursionError"),
    "a defect of ours": (key_error, "KeyError"),
    "sys.exit": (leave, "SystemExit"),
    "os._exit": (lambda: os._exit(0), "code 0"),
    "a long answer": (lambda: bytes(1001), "1000 bytes"),
}


@pytest.mark.whole
@pytest.mark.parametrize("case", CRASHES)
def test_what_the_input_breaks_is_refused_and_not_tried_again(case: str) -> None:
    work, fate = CRASHES[case]
    with pytest.raises(SandboxCrashedError, match=fate) as raised:
        sandboxed(work, SMALL)
    assert raised.value.code == "reader_crashed"
    assert not isinstance(raised.value, PlatformFaultError)
    assert "secret" not in str(raised.value)


FAULTS: dict[str, tuple[Work, SandboxLimits, str]] = {
    "a kill from outside": (lambda: killed(signal.SIGKILL), SMALL, "outside"),
    "a clock that runs out": (asleep, SandboxLimits(wall_s=0.01), "0.01 s of wall"),
    "a file that is gone": (lambda: Path("/nowhere").read_bytes(), SMALL, "FileNotFoundError"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_what_the_machine_breaks_is_tried_again(case: str) -> None:
    work, limits, fate = FAULTS[case]
    with pytest.raises(SandboxInterruptedError, match=fate):
        sandboxed(work, limits)
    assert issubclass(SandboxInterruptedError, PlatformFaultError)


def test_the_answer_comes_back_whole() -> None:
    answer = os.urandom(3 * 2**20)  # more than a pipe holds
    assert sandboxed(lambda: answer) == answer
    assert sandboxed(lambda: b"") == b""


def test_a_refusal_comes_back_as_the_same_leaf_with_the_same_sentence() -> None:
    def refuse() -> bytes:
        raise SubmissionError("corrupt", "a sound file " + "ä" * 1000, "\x1b[31m another\n")

    with refused_as("corrupt") as here:
        refuse()
    with refused_as("corrupt") as there:
        sandboxed(refuse)
    assert (str(there.value), there.value.code) == (str(here.value), "corrupt")


@pytest.mark.parametrize("code", ["", "Bad", "a b", "x" * 64, "BAG-1", "ä"])
def test_a_code_that_nobody_writes_is_a_crash(code: str) -> None:
    def refuse() -> bytes:
        raise Refused(code, "a sentence")

    with pytest.raises(SandboxCrashedError):
        sandboxed(refuse)


def test_a_leaf_that_only_the_child_knows_is_a_crash() -> None:
    def refuse() -> bytes:
        class StrangeError(StoneError):
            code = "strange"

        raise StrangeError("a sentence")

    with pytest.raises(SandboxCrashedError):
        sandboxed(refuse)


def test_progress_is_told_in_order_and_a_wish_to_stop_ends_the_child() -> None:
    told: list[tuple[str, int, int]] = []

    def count_to_three(progress: ProgressCallback) -> bytes:
        for done in (1, 2, 3):
            progress("score", done, 3)
        return b"done"

    watch = SandboxWatch(progress=lambda *step: told.append(step))
    assert sandboxed_with_progress(count_to_three, watch=watch) == b"done"
    assert told == [("score", 1, 3), ("score", 2, 3), ("score", 3, 3)]


class StopAskedError(Exception):
    pass


def stop() -> None:
    raise StopAskedError


def test_the_parent_may_stop_a_child_that_says_nothing() -> None:
    with pytest.raises(StopAskedError):
        sandboxed(asleep, watch=SandboxWatch(on_poll=stop))


def test_the_parent_may_stop_at_a_tick() -> None:
    def tell_for_ever(progress: ProgressCallback) -> bytes:
        while True:
            progress("score", 1, 2)

    with pytest.raises(StopAskedError):
        sandboxed_with_progress(tell_for_ever, watch=SandboxWatch(progress=lambda *step: stop()))


def test_children_of_many_threads_do_not_wait_for_each_other() -> None:
    """A sibling holds a copy of the pipe: its end alone does not say that a child has ended."""

    def one(number: int) -> str:
        if number == 0:
            return sandboxed(lambda: asleep(0.3)).decode()
        with pytest.raises(SandboxCrashedError, match="code 3"):
            sandboxed(lambda: os._exit(3))
        return "crashed"

    assert at_once(4, one) == ["slow", "crashed", "crashed", "crashed"]


def test_locks_and_garbage_of_the_parent_are_left_alone() -> None:
    """Garbage of the parent, finalised in the child, would speak on connections that they share."""
    ours, theirs = socket.socketpair()

    class Connection:
        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            ours.send(b"rollback")

    gc.disable()
    try:
        Connection()
        sandboxed(lambda: bytes(gc.collect() * 0))
        theirs.setblocking(False)
        with pytest.raises(BlockingIOError):
            theirs.recv(100)
    finally:
        gc.enable()
        gc.collect()
        ours.close()
        theirs.close()


def test_signals_of_the_parent_are_not_answered_by_the_child() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGUSR1, lambda number, _: heard.append(number))
    try:
        with pytest.raises(SandboxCrashedError, match="SIGUSR1"):
            sandboxed(lambda: killed(signal.SIGUSR1))
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert heard == []


def test_the_limits_hold_in_the_child_alone() -> None:
    names = (resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE)
    before = [resource.getrlimit(name) for name in names]
    answer = sandboxed(lambda: str(resource.getrlimit(resource.RLIMIT_CPU)).encode(), SMALL)
    assert answer == b"(1, 2)"
    assert [resource.getrlimit(name) for name in names] == before


PARENT = """
import os, sys, time
from services.runtime.sandbox import sandboxed
from services.runtime.telemetry.log_lines import speak_json
speak_json()  # to stderr
def work():
    os.write(1, f"{os.getpid()}\\n".encode())
    time.sleep(600)
sandboxed(work)
"""
# What Celery's prefork pool does: a daemonic billiard process with threads beside the task.
WORKER = """
import threading, time
import billiard
from services.runtime.sandbox import SandboxLimits, sandboxed
from services.runtime.sandbox.errors import SandboxCrashedError
import os
def task(answers):
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    answers.put(sandboxed(lambda: b"answered"))
    try:
        sandboxed(lambda: os.abort(), SandboxLimits(cpu_s=1))
    except SandboxCrashedError as error:
        answers.put(str(error))
if __name__ == "__main__":
    context = billiard.get_context("fork")
    answers = context.SimpleQueue()
    process = context.Process(target=task, args=(answers,), daemon=True)
    process.start()
    print(answers.get(), answers.get())
    process.join()
"""


def test_the_child_of_a_killed_parent_ends_with_it() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert is_running(child)
        parent.kill()
        parent.wait(300)
        until(lambda: not is_running(child))


def test_a_prefork_worker_may_confine() -> None:
    run = subprocess.run([sys.executable, "-c", WORKER], capture_output=True, text=True, timeout=300)
    assert "b'answered'" in run.stdout, run.stderr
    assert "SIGABRT" in run.stdout
