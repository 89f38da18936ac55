"""Runs the tasks of a stage in other processes, and yields their results in the order of the tasks.

**Conventions.** Workers come from a fork server that has imported the kernels and Open3D but used neither, each
with one thread for every library: the parallelism is over tasks, and the caller's own process stays small.
`ProcessPoolExecutor`, not `multiprocessing.Pool`, which once wrote all its results and never returned.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from threading import Thread
from typing import Generic, TypeVar

from services.runtime.usage import peak_bytes, used_cpu_s

T = TypeVar("T")
PRELOAD = ["open3d", "services.labeler.fuse", "services.labeler.surface", "services.labeler.frames"]


@dataclass(frozen=True)
class Done(Generic[T]):
    """The result of one task, and what its process has used so far."""

    value: T
    peak_bytes: int
    cpu_s: float
    pid: int


class Workers:
    """`with Workers(n) as workers: for done in workers.run(task, arguments): …`."""

    def __init__(self, processes: int) -> None:
        context = get_context("forkserver")
        context.set_forkserver_preload(PRELOAD)
        self._pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_prepare)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        """Wait for the workers to end; after a failure (Ctrl-C too) do not wait for what they are at."""
        if failure is not None:
            for process in list((self._pool._processes or {}).values()):  # no public way until Python 3.14
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def run(self, task: Callable[..., T], arguments: Sequence[tuple[object, ...]]) -> Iterator[Done[T]]:
        """The result of `task(*arguments[i])` for every i, in order; the first that raises ends the stage."""
        futures = [self._pool.submit(_measured, task, one) for one in arguments]
        return (future.result() for future in futures)


def _measured(task: Callable[..., T], arguments: tuple[object, ...]) -> Done[T]:
    value = task(*arguments)
    return Done(value, peak_bytes(), used_cpu_s(), os.getpid())


def _prepare() -> None:
    """One thread for every library, and no life beyond that of the process that asked."""
    asker = parent_process()
    if asker is not None:
        Thread(target=_end_with, args=(asker.sentinel,), daemon=True).start()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def _end_with(sentinel: int) -> None:
    """Exit when the other end goes away, however it went: a killed command leaves no worker behind."""
    connection.wait([sentinel])
    os._exit(1)
