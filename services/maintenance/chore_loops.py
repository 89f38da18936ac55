"""Chores that are done again and again, in loops that run side by side.

**Conventions.** A loop is one thread, so that no chore waits for one of another loop, however long that takes or hangs.
An outage of the database or the broker is waited out: the next round finds everything that was missed. A fault of the
program in any loop ends them all, and the process with them: whoever watches it starts it again.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Thread

import structlog
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.telemetry.counters import CHORE_FAILURES, process_counters
from stone.errors import PlatformFaultError

LONGEST_PAUSE_S = 0.5
WATCHED_S = 0.1

log = structlog.get_logger(__name__)


def nobody(_name: str) -> None:
    """Told to nobody."""


@dataclass
class Chore:
    """Something done every `every_s`; `due_s` is on the monotonic clock. `told` hears its name when it was done."""

    name: str
    every_s: float
    work: Callable[[], object]
    due_s: float = 0.0
    told: Callable[[str], None] = nobody

    def run_if_due(self, now_s: float) -> bool:
        """Do it when its time has come; false when an outage kept it from being done."""
        if now_s < self.due_s:
            return True
        self.due_s = now_s + self.every_s
        try:
            self.work()
        except (SQLAlchemyError, RedisError, PlatformFaultError, OSError) as error:
            log.warning("not done this time", chore=self.name, reason=f"{type(error).__name__}: {error}"[:500])
            process_counters().add(CHORE_FAILURES, (self.name,))
            return False
        self.told(self.name)
        return True


@dataclass(frozen=True)
class ChoreLoop:
    """Chores that one thread does in turn."""

    name: str
    chores: tuple[Chore, ...]


def sweep(chores: Sequence[Chore], is_stopped: Callable[[], bool]) -> None:
    """Do each chore whenever it is due, until told to stop: between two of them."""
    pause_s = min(min(chore.every_s for chore in chores) / 2, LONGEST_PAUSE_S)
    while not is_stopped():
        for chore in chores:
            if not is_stopped():
                chore.run_if_due(time.monotonic())
        time.sleep(pause_s)


def sweep_side_by_side(loops: Sequence[ChoreLoop], is_stopped: Callable[[], bool]) -> None:
    """Each loop in a thread of its own until told to stop, when all are waited for.

    The first fault of the program is raised, without waiting for what the other loops are at.
    """
    faults: list[Exception] = []

    def run(loop: ChoreLoop) -> None:
        try:
            sweep(loop.chores, lambda: is_stopped() or bool(faults))
        except Exception as fault:
            faults.append(fault)

    threads = [Thread(target=run, args=(loop,), name=loop.name, daemon=True) for loop in loops]
    for thread in threads:
        thread.start()
    while not faults and any(thread.is_alive() for thread in threads):
        time.sleep(WATCHED_S)
    if faults:
        raise faults[0]
