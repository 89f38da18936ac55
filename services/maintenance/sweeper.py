"""The sweeper process: recovers jobs and submissions every second, cleans uploads and blobs every minute.

**Conventions.** Any number of sweepers may run. Jobs are recovered in a separate thread, which nothing else delays.
Submissions, later recordings, cleaning, the scrub, notifications and records have their own threads (`chore_loops`).
Each turn of a chore is bounded, regardless of the users' load; the next turn continues. SIGTERM ends each thread
between two chores.
"""

import services.runtime.processes.seldom_collected
import services.runtime.processes.sound_settings  # noqa: F401

# isort: split

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from threading import Thread
from types import FrameType

import structlog
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError

from services.domain.benchmarks.submissions.sweeper_chores import DraftWalk, settle_ended, tidy_submissions
from services.domain.notifications.spread import (
    delete_old_events,
    queue_due,
    record_phase_events,
    retry_lost,
    spread_events,
)
from services.domain.sequences.label_set_deletion import LabelSetWalk, keep_newest
from services.domain.sequences.later_recordings import SequenceWalk, follow_recordings
from services.maintenance.notifications.delivery import deliver_queued
from services.maintenance.scrub import Scrub
from services.runtime.access.retention import cut_audit, forget_ended
from services.runtime.database.ballast import Ballast
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.jobs.wakeup import wake_up_counter, wake_up_sender
from services.runtime.jobs.worker_presence import forget_silent
from services.runtime.platform import Platform, platform
from services.runtime.processes.health_check import HeartbeatFile
from services.runtime.processes.private_files import keep_private
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.store.gc_holds import GcCursor
from services.runtime.telemetry.counter_rows import fold
from services.runtime.telemetry.counters import CHORE_FAILURES, process_counters
from services.runtime.telemetry.log_lines import speak_json
from services.runtime.telemetry.sweeper_statistics import ChoreLedger, StoreSum
from services.runtime.telemetry.tracing import close_tracing, setup_tracing
from services.runtime.uploads import expire
from services.runtime.uploads.expiry import UploadCursor
from stone.errors import PlatformFaultError

# Chores that are repeated in parallel loops. A loop is one thread, so that a slow or blocked chore delays no other
# loop. During an outage of the database or the broker the loops wait: the next round finds all missed work. A program
# fault in any loop ends all loops and the process, which its supervisor restarts.


LONGEST_PAUSE_S = 0.5
WATCHED_S = 0.1

log = structlog.get_logger(__name__)


def ignore(_name: str) -> None:
    """Ignore the finished chore; the default callback."""


@dataclass
class Chore:
    """A task repeated every `every_s`; `due_s` is on the monotonic clock. `on_done` is then called with its name."""

    name: str
    every_s: float
    work: Callable[[], object]
    due_s: float = 0.0
    on_done: Callable[[str], None] = ignore

    def run_if_due(self, now_s: float) -> bool:
        """Run the chore if it is due; return False if an outage prevented it."""
        if now_s < self.due_s:
            return True
        self.due_s = now_s + self.every_s
        try:
            self.work()
        except (SQLAlchemyError, RedisError, PlatformFaultError, OSError) as error:
            log.warning("chore failed", chore=self.name, reason=f"{type(error).__name__}: {error}"[:500])
            process_counters().add(CHORE_FAILURES, (self.name,))
            return False
        self.on_done(self.name)
        return True


@dataclass(frozen=True)
class ChoreLoop:
    """Chores that one thread runs in turn."""

    name: str
    chores: tuple[Chore, ...]


def sweep(chores: Sequence[Chore], is_stopped: Callable[[], bool]) -> None:
    """Run each chore when it is due, until `is_stopped` returns True between two chores."""
    pause_s = min(min(chore.every_s for chore in chores) / 2, LONGEST_PAUSE_S)
    while not is_stopped():
        for chore in chores:
            if not is_stopped():
                chore.run_if_due(time.monotonic())
        time.sleep(pause_s)


def sweep_side_by_side(loops: Sequence[ChoreLoop], is_stopped: Callable[[], bool]) -> None:
    """Run each loop in its own thread until stopped, then wait for all threads.

    The first program fault is raised without waiting for the other loops.
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


# isort: split


MINUTE_S = 60.0
FOLLOW_S = 5.0
HEARTBEAT_S = 5.0
LEDGER_S = 10.0
SCRUB_S = 1.0
SENDERS = ("senderone", "sendertwo")
"""Number of concurrent deliveries; a slow receiver blocks one of them for seconds."""


def loops_of(platform: Platform) -> tuple[ChoreLoop, ...]:
    """Return the sweeper's loops on this platform."""
    settings = platform.settings
    sweeper = Sweeper(platform, wake_up_counter(settings), wake_up_sender(settings))
    uploads, turn, drafts, sequences = UploadCursor(), GcCursor(), DraftWalk(), SequenceWalk()
    label_sets = LabelSetWalk()
    cleaning = (
        Chore("submitted files", MINUTE_S, lambda: tidy_submissions(platform, drafts)),
        Chore("uploads", MINUTE_S, lambda: expire(platform, uploads)),
        Chore("label sets", MINUTE_S, lambda: keep_newest(platform, label_sets)),
        Chore("blobs", MINUTE_S, lambda: collect_garbage(platform, turn)),
        Chore("credentials", MINUTE_S, lambda: forget_ended(platform)),
        Chore("audit log", MINUTE_S, lambda: cut_audit(platform)),
        Chore("workers", MINUTE_S, lambda: forget_silent(platform)),
        *((Chore("ballast", MINUTE_S, Ballast(settings).make),) if platform.database.is_sqlite else ()),
    )
    return (
        ChoreLoop("jobs", (Chore("jobs", settings.jobs.sweep_s, sweeper.sweep),)),
        ChoreLoop("submissions", (Chore("submissions", settings.jobs.sweep_s, lambda: settle_ended(platform)),)),
        ChoreLoop("recordings", (Chore("recordings", FOLLOW_S, lambda: follow_recordings(platform, sequences)),)),
        ChoreLoop("cleaning", cleaning),
        ChoreLoop("scrub", (Chore("scrub", SCRUB_S, Scrub(platform).turn),)),
        ChoreLoop("notifications", _notifying(platform)),
        *(ChoreLoop(name, (Chore(name, settings.jobs.sweep_s, lambda: deliver_queued(platform)),)) for name in SENDERS),
    )


def _notifying(platform: Platform) -> tuple[Chore, ...]:
    """Return the chores that turn events into deliveries and deliveries into jobs; the senders run the jobs."""
    often_s = platform.settings.jobs.sweep_s
    return (
        Chore("phases", often_s, lambda: record_phase_events(platform)),
        Chore("events", often_s, lambda: spread_events(platform)),
        Chore("deliveries", often_s, lambda: queue_due(platform)),
        Chore("lost deliveries", often_s, lambda: retry_lost(platform)),
        Chore("old events", MINUTE_S, lambda: delete_old_events(platform)),
    )


def recorded(platform: Platform, loops: Sequence[ChoreLoop]) -> tuple[ChoreLoop, ...]:
    """Return the loops with every finished chore recorded, and the chores of platform-wide metrics."""
    ledger, stored = ChoreLedger(platform), StoreSum(platform)
    records = ChoreLoop(
        "records",
        (
            Chore("size of the store", LEDGER_S, stored.step),
            Chore("counts", MINUTE_S, lambda: fold(platform)),
        ),
    )
    observed = [
        replace(loop, chores=tuple(replace(chore, on_done=ledger.note) for chore in loop.chores))
        for loop in (*loops, records)
    ]
    observed[-1] = replace(observed[-1], chores=(*observed[-1].chores, Chore("books", LEDGER_S, ledger.write)))
    return tuple(observed)


def beating(loop: ChoreLoop, pulse: HeartbeatFile) -> ChoreLoop:
    """Return the loop with a heartbeat `pulse` in each round."""
    return replace(loop, chores=(Chore("pulse", HEARTBEAT_S, pulse.beat), *loop.chores))


class StopSignal:
    """Whether SIGTERM or SIGINT was received; an `Event` may deadlock if a signal sets it while it is waited for."""

    def __init__(self) -> None:
        self._came = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._hear)

    def __call__(self) -> bool:
        return self._came

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self._came = True


def main() -> None:
    from services.runtime.processes.startup import await_schema  # Alembic is only needed once

    keep_private()
    speak_json()
    await_schema(platform().settings)
    setup_tracing("stone-sweeper")
    loops = recorded(platform(), loops_of(platform()))
    pulses = [HeartbeatFile(platform().settings.root, part=loop.name) for loop in loops]
    sweep_side_by_side([beating(*pair) for pair in zip(loops, pulses, strict=True)], StopSignal())
    for pulse in pulses:
        pulse.stop()
    close_tracing()


if __name__ == "__main__":
    main()
