"""A worker in a thread, for tests whose commands wait for a job."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Handlers
from services.runtime.platform import Platform

IDLE_S = 0.05


@contextmanager
def working(platform: Platform, queue: str, handlers: Callable[[Platform], Handlers]) -> Iterator[None]:
    """A worker of the queue meanwhile."""
    is_over = threading.Event()

    def work() -> None:
        while not is_over.wait(IDLE_S):
            run_next(platform, queue, handlers(platform))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
