"""The process that takes up what died: jobs every second, expired uploads and unnamed blobs every minute.

**Conventions.** Any number of sweepers may run. An outage of the database or the broker is waited out: the next round
finds everything that was missed. SIGTERM ends it between two rounds.
"""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event
from types import FrameType

import structlog
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.bell import ring, waiting
from services.runtime.blobs import collect
from services.runtime.jobs.sweeping import Sweeper
from services.runtime.platform import Platform, platform
from services.runtime.uploads import expire

MINUTE_S = 60.0

log = structlog.get_logger(__name__)


@dataclass
class Chore:
    """Something done every `every_s`; `due_s` is on the monotonic clock."""

    name: str
    every_s: float
    work: Callable[[], object]
    due_s: float = 0.0

    def run_if_due(self, now_s: float) -> bool:
        """Do it when its time has come; false when an outage kept it from being done."""
        if now_s < self.due_s:
            return True
        self.due_s = now_s + self.every_s
        try:
            self.work()
        except (SQLAlchemyError, RedisError, OSError) as error:
            log.warning("not done this time", chore=self.name, reason=f"{type(error).__name__}: {error}"[:500])
            return False
        return True


def chores_of(platform: Platform) -> tuple[Chore, ...]:
    """What the sweeper does on this platform."""
    settings = platform.settings
    sweeper = Sweeper(platform, waiting(settings), ring(settings))
    return (
        Chore("jobs", settings.jobs.sweep_s, sweeper.sweep),
        Chore("uploads", MINUTE_S, lambda: expire(platform)),
        Chore("blobs", MINUTE_S, lambda: collect(platform)),
    )


def sweep_until(stopped: Event, chores: tuple[Chore, ...]) -> None:
    """Do each chore whenever it is due, until `stopped`."""
    pause_s = min(chore.every_s for chore in chores) / 2
    while not stopped.wait(pause_s):
        for chore in chores:
            chore.run_if_due(time.monotonic())


def main() -> None:
    stopped = Event()

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    sweep_until(stopped, chores_of(platform()))


if __name__ == "__main__":
    main()
