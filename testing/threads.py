"""Threads that act at the same moment, as requests of several people would."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import TypeVar

from stone.errors import StoneError

PATIENCE_S = 300.0
T = TypeVar("T")


def at_once(count: int, act: Callable[[int], T]) -> list[T]:
    """Return the results of `count` threads that start together; `act` receives their numbers."""
    together = Barrier(count)

    def begin(number: int) -> T:
        together.wait(PATIENCE_S)
        return act(number)

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(begin, range(count)))


def granted(count: int, act: Callable[[int], object], *codes: str) -> int:
    """Return how many of `count` concurrent calls are not refused with one of these codes."""

    def is_granted(number: int) -> bool:
        try:
            act(number)
        except StoneError as error:
            if error.code not in codes:
                raise
            return False
        return True

    return sum(at_once(count, is_granted))
