"""The process that takes up what died: jobs and submissions every second, uploads and blobs every minute.

**Conventions.** Any number of sweepers may run. An outage of the database or the broker is waited out: the next round
finds everything that was missed. SIGTERM ends it between two rounds.
"""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType

import structlog
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError

from services.runtime.bell import ring, waiting
from services.runtime.benchmarks.submission_chores import settle_ended, tidy_submissions
from services.runtime.collection import collect
from services.runtime.errors import PlatformFaultError
from services.runtime.jobs.presence import forget_silent
from services.runtime.jobs.sweeping import Sweeper
from services.runtime.log_lines import speak_json
from services.runtime.platform import Platform, platform
from services.runtime.uploads import expire

MINUTE_S = 60.0
LONGEST_PAUSE_S = 0.5

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
        except (SQLAlchemyError, RedisError, PlatformFaultError, OSError) as error:
            log.warning("not done this time", chore=self.name, reason=f"{type(error).__name__}: {error}"[:500])
            return False
        return True


def chores_of(platform: Platform) -> tuple[Chore, ...]:
    """What the sweeper does on this platform."""
    settings = platform.settings
    sweeper = Sweeper(platform, waiting(settings), ring(settings))
    return (
        Chore("jobs", settings.jobs.sweep_s, sweeper.sweep),
        Chore("submissions", settings.jobs.sweep_s, lambda: settle_ended(platform)),
        Chore("submitted files", MINUTE_S, lambda: tidy_submissions(platform)),
        Chore("uploads", MINUTE_S, lambda: expire(platform)),
        Chore("blobs", MINUTE_S, lambda: collect(platform)),
        Chore("workers", MINUTE_S, lambda: forget_silent(platform)),
    )


def sweep(chores: tuple[Chore, ...], is_stopped: Callable[[], bool]) -> None:
    """Do each chore whenever it is due, until told to stop."""
    pause_s = min(min(chore.every_s for chore in chores) / 2, LONGEST_PAUSE_S)
    while not is_stopped():
        for chore in chores:
            chore.run_if_due(time.monotonic())
        time.sleep(pause_s)


class Wish:
    """Whether SIGTERM or SIGINT came. No `Event`: one set by a signal while it is waited for may deadlock."""

    def __init__(self) -> None:
        self._came = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._hear)

    def __call__(self) -> bool:
        return self._came

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self._came = True


def main() -> None:
    speak_json()
    sweep(chores_of(platform()), Wish())


if __name__ == "__main__":
    main()
