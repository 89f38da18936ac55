"""The sweeper process: recovers jobs and submissions every second, cleans uploads and blobs every minute.

**Conventions.** Any number of sweepers may run. An outage of the database or the broker is waited out: the next round
finds everything that was missed. SIGTERM ends it between two rounds.
"""

import services.runtime.processes.sound_settings  # noqa: F401

# isort: split

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import FrameType

import structlog
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError

from services.domain.benchmarks.submissions.chores import settle_ended, tidy_submissions
from services.runtime.access.audit_retention import cut_audit
from services.runtime.access.retention import forget_ended
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.jobs.wakeup import wake_up_counter, wake_up_sender
from services.runtime.jobs.worker_presence import forget_silent
from services.runtime.platform import Platform, platform
from services.runtime.processes.heartbeat_file import HeartbeatFile
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.store.gc_cursor import GcCursor
from services.runtime.telemetry.counter_rows import fold
from services.runtime.telemetry.counters import process_counters
from services.runtime.telemetry.log_lines import speak_json
from services.runtime.telemetry.metric_names import CHORE_FAILURES
from services.runtime.telemetry.sweeper_statistics import ChoreLedger, StoreSum
from services.runtime.telemetry.tracing import close_tracing, setup_tracing
from services.runtime.uploads import expire
from stone.errors import PlatformFaultError

MINUTE_S = 60.0
LONGEST_PAUSE_S = 0.5
HEARTBEAT_S = 5.0
LEDGER_S = 10.0

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


def chores_of(platform: Platform) -> tuple[Chore, ...]:
    """What the sweeper does on this platform."""
    settings = platform.settings
    sweeper, turn = Sweeper(platform, wake_up_counter(settings), wake_up_sender(settings)), GcCursor()
    return (
        Chore("jobs", settings.jobs.sweep_s, sweeper.sweep),
        Chore("submissions", settings.jobs.sweep_s, lambda: settle_ended(platform)),
        Chore("submitted files", MINUTE_S, lambda: tidy_submissions(platform)),
        Chore("uploads", MINUTE_S, lambda: expire(platform)),
        Chore("blobs", MINUTE_S, lambda: collect_garbage(platform, turn)),
        Chore("credentials", MINUTE_S, lambda: forget_ended(platform)),
        Chore("audit log", MINUTE_S, lambda: cut_audit(platform)),
        Chore("workers", MINUTE_S, lambda: forget_silent(platform)),
    )


def recorded(platform: Platform, chores: tuple[Chore, ...]) -> tuple[Chore, ...]:
    """These, each written down when it was done; and what is told of the platform by nobody else."""
    ledger, stored = ChoreLedger(platform), StoreSum(platform)
    told = tuple(replace(chore, told=ledger.note) for chore in chores)
    return (
        *told,
        Chore("size of the store", LEDGER_S, stored.step, told=ledger.note),
        Chore("counts", MINUTE_S, lambda: fold(platform), told=ledger.note),
        Chore("books", LEDGER_S, ledger.write),
    )


def sweep(chores: tuple[Chore, ...], is_stopped: Callable[[], bool]) -> None:
    """Do each chore whenever it is due, until told to stop."""
    pause_s = min(min(chore.every_s for chore in chores) / 2, LONGEST_PAUSE_S)
    while not is_stopped():
        for chore in chores:
            chore.run_if_due(time.monotonic())
        time.sleep(pause_s)


class StopSignal:
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
    from services.runtime.processes.startup import await_schema  # Alembic is needed once

    speak_json()
    await_schema(platform().settings)
    pulse = HeartbeatFile(platform().settings.root)
    setup_tracing("stone-sweeper")
    sweep((Chore("pulse", HEARTBEAT_S, pulse.beat), *recorded(platform(), chores_of(platform()))), StopSignal())
    pulse.stop()
    close_tracing()


if __name__ == "__main__":
    main()
