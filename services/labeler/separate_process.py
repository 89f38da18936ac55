"""Runs a function in a separate process while the caller's threads continue.

**Conventions.** For native code that keeps the interpreter's lock as long as it runs (Open3D's solver: all 3.8 s of a
tile of 400,000 points): no heartbeat would go out, and an attempt that works would be taken for lost. The child is a
fork, so arguments cost nothing and what is imported stays so; it runs nothing but the function and dies with us. What
it uses is in `RUSAGE_CHILDREN`.
"""

import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable
from typing import NoReturn, TypeVar

from services.runtime.processes.parent_death import die_with

T = TypeVar("T")


class ChildEndedError(Exception):
    """The process ended without an answer: killed, out of memory or crashed; perhaps no fault of the input."""

    def __init__(self, function: str, status: int) -> None:
        code = os.waitstatus_to_exitcode(status)
        fate = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        super().__init__(f"the process of {function} {fate} without an answer (out of memory?)")


def apart(function: Callable[..., T], *arguments: object) -> T:
    """`function(*arguments)`, or what it raises. Raises `ChildEndedError`.

    Called by a thread that outlives the call, as all do that wait for the answer.
    """
    reading, writing = os.pipe()
    parent = os.getpid()
    pid = _forked()
    if pid == 0:
        die_with(parent)
        _answer(writing, function, arguments)
    try:
        os.close(writing)
        with os.fdopen(reading, "rb") as answer:
            payload = answer.read()
    except BaseException:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise
    _, status = os.waitpid(pid, 0)
    if status or not payload:
        raise ChildEndedError(function.__name__, status)
    is_value, found = pickle.loads(payload)
    if not is_value:
        raise found
    value: T = found
    return value


def _forked() -> int:
    """Python 3.12 warns of forks beside threads; this child takes no lock that a thread may hold."""
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _answer(writing: int, function: Callable[..., T], arguments: tuple[object, ...]) -> NoReturn:
    """In the child: nothing may go up the stack from here, which is the parent's."""
    status = 1
    answer: tuple[bool, object]
    try:
        try:
            answer = (True, function(*arguments))
        except Exception as error:
            answer = (False, error)
        payload = pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(payload)
        status = 0
    finally:
        os._exit(status)
