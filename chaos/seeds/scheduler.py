"""A scheduler of greenlets on a virtual clock: it draws the next task among the due tasks.

**Conventions.** A task yields its turn only in `pause`. A process is a group of tasks that die together. Each task of a
dead process raises `Killed` at every pause, and no `except Exception` catches it. A held process continues later, as
after SIGSTOP.
"""

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest import mock
from zlib import crc32

from greenlet import getcurrent, greenlet

from services.runtime.jobs import claims, execution

NEVER_S = float("inf")


class Killed(BaseException):
    """The process of this task is dead."""


@dataclass(eq=False)
class Process:
    """A group of tasks; `attempt` is the (job, number) that runs in it."""

    name: str
    is_dead: bool = False
    held_until_s: float = 0.0
    attempt: tuple[str, int] = ("", 0)


@dataclass(eq=False)
class Task:
    """A greenlet of a process; `due_s` is the time at which it may continue."""

    name: str
    process: Process
    due_s: float
    greenlet: greenlet = field(init=False)

    @property
    def next_s(self) -> float:
        return max(self.due_s, self.process.held_until_s)


class Scheduler:
    """`spawn` tasks, then `run`. Any exception of a task except `Killed` ends the run.

    `trace` is a checksum of the process and time of each turn; a history that is played again has the same checksum.
    """

    def __init__(self, dice: random.Random) -> None:
        self.dice, self.now_s = dice, 1000.0
        self.turns = self.trace = 0
        self._hub = getcurrent()
        self._tasks: list[Task] = []
        self._current: Task | None = None

    @property
    def current(self) -> Task:
        if self._current is None:
            raise LookupError("no task has the turn")
        return self._current

    def spawn(self, process: Process, name: str, work: Callable[[], None]) -> Task:
        task = Task(name, process, self.now_s)
        task.greenlet = greenlet(lambda: self._play(work), self._hub)
        self._tasks.append(task)
        return task

    def pause(self, seconds: float = 0.0) -> None:
        """Yield the turn, and continue after at least `seconds`. Raises `Killed`."""
        task = self.current
        task.due_s = self.now_s + seconds
        if not task.process.is_dead:
            self._hub.switch()
        if task.process.is_dead:
            raise Killed

    def kill(self, process: Process) -> None:
        """End all tasks of the process; the current task dies at its next pause."""
        process.is_dead = True

    def run(self, goes_on: Callable[[], bool]) -> None:
        while goes_on():
            self._bury()
            next_s = min(task.next_s for task in self._tasks)
            self.now_s = max(self.now_s, next_s)
            due = [task for task in self._tasks if task.next_s <= self.now_s]
            self._turn(due[self.dice.randrange(len(due))])

    def close(self) -> None:
        """Unwind the remaining tasks."""
        for task in self._tasks:
            task.process.is_dead = True
        while self._tasks:
            self._bury()

    def _turn(self, task: Task, *thrown: type[BaseException]) -> None:
        self.turns += 1
        self.trace = crc32(f"{task.process.name} {self.now_s}".encode(), self.trace)
        self._current = task
        try:
            if thrown:
                task.greenlet.throw(*thrown)
            else:
                task.greenlet.switch()
        finally:
            self._current = None
            if task.greenlet.dead:
                self._tasks.remove(task)

    def _bury(self) -> None:
        for task in [task for task in self._tasks if task.process.is_dead]:
            if task.greenlet:
                self._turn(task, Killed)
            else:  # not started
                self._tasks.remove(task)

    def _play(self, work: Callable[[], None]) -> None:
        with suppress(Killed):
            work()


class VirtualEvent:
    """A `threading.Event` on the virtual clock."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler, self._is_set = scheduler, False
        self._waiting: list[Task] = []

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True
        for task in self._waiting:
            task.due_s = min(task.due_s, self._scheduler.now_s)
        self._waiting.clear()

    def clear(self) -> None:
        self._is_set = False

    def wait(self, timeout: float = NEVER_S) -> bool:
        if not self._is_set:
            self._waiting.append(self._scheduler.current)
            self._scheduler.pause(timeout)
        return self._is_set


class VirtualThread:
    """A `threading.Thread` that is a task of the process that starts it."""

    def __init__(
        self, scheduler: Scheduler, target: Callable[..., Any], args: tuple[Any, ...], name: str, **_: Any
    ) -> None:
        self._scheduler, self._name = scheduler, name
        self._ended = VirtualEvent(scheduler)
        self._work: Callable[[], object] = partial(target, *args)

    def start(self) -> None:
        self._scheduler.spawn(self._scheduler.current.process, self._name, self._play)

    def join(self) -> None:
        self._ended.wait()

    def _play(self) -> None:
        self._work()
        self._ended.set()


@contextmanager
def virtual(scheduler: Scheduler) -> Iterator[None]:
    """Execute jobs inside this context on the scheduler's clock, threads and processes."""

    def exit_process(_code: int) -> None:
        scheduler.kill(scheduler.current.process)
        raise Killed

    def process_name() -> str:
        return scheduler.current.process.name

    clock = SimpleNamespace(monotonic=lambda: scheduler.now_s, sleep=scheduler.pause)
    with (
        mock.patch.object(execution, "time", clock),
        mock.patch.object(execution, "os", SimpleNamespace(_exit=exit_process)),
        mock.patch.object(execution, "Event", partial(VirtualEvent, scheduler)),
        mock.patch.object(execution, "Thread", partial(VirtualThread, scheduler)),
        mock.patch.object(claims, "worker_name", process_name),
    ):
        yield
