"""A worker in a thread, for tests whose commands wait for a job."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Handlers
from services.runtime.platform import Platform

SHORTEST_REST_S, LONGEST_REST_S = 0.02, 0.25


@contextmanager
def working(platform: Platform, queue: str, handlers: Callable[[Platform], Handlers]) -> Iterator[None]:
    """A worker of the queue meanwhile; it asks for work the more seldom the longer there is none."""
    is_over = threading.Event()

    def work() -> None:
        rest_s = SHORTEST_REST_S
        while not is_over.wait(rest_s):
            has_worked = run_next(platform, queue, handlers(platform))
            rest_s = SHORTEST_REST_S if has_worked else min(2 * rest_s, LONGEST_REST_S)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
