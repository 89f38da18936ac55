"""What several use at once, each slower for it: processor sharing, for the cores of a machine and the line to a store.

**Conventions.** All who use it go at one speed at a time, `speed(n)` with n of them: so a clock that runs at that speed
says when each is through, whenever others come and go, and only the next to leave is in the event queue. Kleinrock
(1967), "Time-shared systems: a theoretical treatment".
"""

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush
from math import isinf

from simpy import Environment, Event

Speed = Callable[[int], float]
LEAST = 1e-12


@dataclass(frozen=True)
class Cores:
    """The processors of a machine, `taken` of which others use all the while.

    With every core busy each job is `contention` times as slow as one that has the machine to itself: caches and
    memory are shared too. Between one and all it is in proportion.
    """

    cores: float = 1.0
    contention: float = 1.0
    taken: float = 0.0

    def speed(self, jobs: int) -> float:
        """Of each of `jobs` jobs, 1 for one alone."""
        left = max(self.cores - self.taken, 0.01)
        share = min(1.0, left / jobs)
        busy = min(1.0, max(0.0, jobs + self.taken - 1) / (self.cores - 1)) if self.cores > 1 else 0.0
        return share / (1.0 + (self.contention - 1.0) * busy)


@dataclass(frozen=True)
class Line:
    """Bytes per second of all together, and of one at most."""

    all_bytes_per_s: float = float("inf")
    each_bytes_per_s: float = float("inf")

    def speed(self, users: int) -> float:
        return min(self.each_bytes_per_s, self.all_bytes_per_s / users)


class Shared:
    """`use(amount)` is an event that comes when so much was done at the speed of the moment."""

    def __init__(self, env: Environment, speed: Speed) -> None:
        self._env, self._speed = env, speed
        self._users: list[tuple[float, int, Event]] = []
        self._clock = self._since_s = 0.0
        self._made = self._version = 0
        self.used = 0.0

    def use(self, amount: float) -> Event:
        """Done at once where it is nothing, or where there is no end of speed."""
        event = self._env.event()
        if amount <= 0 or isinf(self._speed(1)):
            return event.succeed()
        self._wind()
        self.used += amount
        self._made += 1
        heappush(self._users, (self._clock + amount, self._made, event))
        self._plan()
        return event

    def _wind(self) -> None:
        now_s = self._env.now
        if self._users:
            self._clock += (now_s - self._since_s) * self._speed(len(self._users))
        self._since_s = now_s

    def _plan(self) -> None:
        self._version += 1
        if self._users:
            left = max(0.0, self._users[0][0] - self._clock)
            alarm = self._env.timeout(left / self._speed(len(self._users)), self._version)
            alarm.callbacks.append(self._ring)

    def _ring(self, alarm: Event) -> None:
        if alarm.value != self._version:  # somebody came or went since
            return
        self._wind()
        self._clock = max(self._clock, self._users[0][0])
        while self._users and self._users[0][0] <= self._clock * (1 + LEAST):
            heappop(self._users)[2].succeed()
        self._plan()
