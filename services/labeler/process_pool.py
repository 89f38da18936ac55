"""Runs tasks in other processes, each after the tasks that it needs.

**Conventions.** Workers come from a fork server that has loaded the common modules
(`services/labeler/kernel_warmup.py`). Each has one thread for every library: the parallelism is over tasks, and the
caller's own process stays small. Processes are used instead of threads because half of a stage is numpy and Python
under the interpreter's lock. `ProcessPoolExecutor` is used because `multiprocessing.Pool` once wrote all its results
and never returned.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import connection, forkserver, get_context, parent_process
from multiprocessing.context import ForkServerContext
from threading import Thread
from typing import Any, Generic, TypeVar

from services.runtime.telemetry.process_usage import peak_bytes, used_cpu_s
from stone_base.process_tuning import keep_freed_memory, tune_label_worker

T = TypeVar("T")
PRELOAD = [
    "services.runtime.one_thread",
    "services.runtime.processes.seldom_collected",
    "services.labeler.kernel_warmup",
    "services.labeler.previews.preview_files",  # imports matplotlib once instead of in each worker
]


@dataclass(frozen=True)
class TaskResult(Generic[T]):
    """The result of one task, its duration, and the total usage of its process."""

    value: T
    busy_s: float
    peak_bytes: int
    cpu_s: float
    pid: int


@dataclass(frozen=True)
class Task:
    """`call(*arguments)` after every task named in `needs`; `key` identifies the task and starts with its stage."""

    key: tuple[object, ...]
    call: Callable[..., Any]
    arguments: tuple[object, ...]
    needs: frozenset[tuple[object, ...]] = frozenset()


def begin_loading() -> None:
    """Start the fork server, which loads the workers' modules while the caller continues; otherwise `Workers` does.

    The caller, which opens the recording meanwhile, keeps freed memory like the workers.
    """
    keep_freed_memory()
    _context()
    forkserver.ensure_running()


def _context() -> ForkServerContext:
    context = get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    return context


class Workers:
    """`with Workers(n) as workers: for task, done in workers.run(tasks): …`."""

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool = ProcessPoolExecutor(processes, mp_context=_context(), initializer=_prepare)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        """Wait for the workers to end; after a failure (or Ctrl-C), do not wait for running tasks."""
        if failure is not None:
            for process in list((self._pool._processes or {}).values()):  # no public API until Python 3.14
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def run(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, TaskResult[Any]]]:
        """Yield every finished task; ready tasks start in order, and the first failure ends all.

        At most one task per process waits in the pool, so that newly ready tasks can go first. Raises ValueError if a
        need is no task's key, or tasks need each other.
        """
        waiting, ended = list(tasks), set[tuple[object, ...]]()
        running: dict[Future[TaskResult[Any]], Task] = {}
        while waiting or running:
            ready = [task for task in waiting if task.needs <= ended][: 2 * self._processes - len(running)]
            running |= {self._pool.submit(_measured, task.call, task.arguments): task for task in ready}
            begun = {task.key for task in ready}
            waiting = [task for task in waiting if task.key not in begun]
            if not running:
                raise ValueError(
                    f"{len(waiting)} tasks wait for results that no task produces, the first is {waiting[0].key}"
                )
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                ended.add(task.key)
                yield task, future.result()


def _measured(task: Callable[..., T], arguments: tuple[object, ...]) -> TaskResult[T]:
    begin = time.perf_counter()
    value = task(*arguments)
    return TaskResult(value, time.perf_counter() - begin, peak_bytes(), used_cpu_s(), os.getpid())


def _prepare() -> None:
    """Prepare a worker: freeze loaded objects for the GC, keep freed memory, use one thread per library.

    The worker ends with the process that started it.
    """
    tune_label_worker()
    asker = parent_process()
    if asker is not None:
        Thread(target=_end_with, args=(asker.sentinel,), daemon=True).start()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def _end_with(sentinel: int) -> None:
    """Exit when the other end closes, so that a killed command leaves no worker behind."""
    connection.wait([sentinel])
    os._exit(1)
