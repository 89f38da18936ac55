"""Recovery of jobs: requeues attempts with expired leases, resends lost wake-ups.

**Conventions.** A sweeper remembers when, on its own monotonic clock, it last saw the heartbeats of an attempt change;
one that stood still for a lease is given back, or failed as `worker_lost` when no attempt is left. No two clocks are
ever compared. A sweeper that could not look has seen nobody stand still: after an outage every attempt has a lease more
in which to be heard. Several sweepers may run; each change is a compare-and-set, so they do nothing twice.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import structlog
from redis import RedisError
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.changes import lock_run, rows_changed
from services.runtime.jobs.claims import Claim, wake_ups_wanted
from services.runtime.jobs.completion import Failure, lose
from services.runtime.jobs.instrumentation import record_lost_attempt
from services.runtime.orm import Job, JobAttempt, Queue
from services.runtime.platform import Platform
from services.runtime.telemetry.counters import WAKE_UPS_RESENT, process_counters

log = structlog.get_logger(__name__)

HeartbeatKey = tuple[str, int]
RUNNING = select(Job).where(Job.state == "running", Job.queue != "")


@dataclass
class Sweeper:
    """`sweep()` every second or so; `waiting(queue)` counts wake-ups not yet received, `ring` sends more."""

    platform: Platform
    waiting: Callable[[str], int]
    ring: Callable[[str, int], None]
    monotonic_s: Callable[[], float] = time.monotonic
    _seen: dict[HeartbeatKey, tuple[int, float]] = field(default_factory=dict)
    _quiet: dict[str, int] = field(default_factory=dict)

    def sweep(self) -> None:
        """Requeue attempts with expired leases, then send wake-ups for ready jobs that have none."""
        self.recover()
        self.resend_wake_ups()

    def recover(self) -> int:
        """Give back every attempt whose heartbeats stood still for a lease; how many there were."""
        now_s = self.monotonic_s()
        running = self._look()
        pulses = {(job.id, job.attempt): job.heartbeats for job in running}
        before, self._seen = self._seen, {}
        for pulse, beats in pulses.items():
            known, since_s = before.get(pulse, (-1, now_s))
            self._seen[pulse] = (beats, since_s if known == beats else now_s)
        lease_s = self.platform.settings.jobs.lease_s
        silent = [job for job in running if now_s - self._seen[job.id, job.attempt][1] >= lease_s]
        return sum(self._lose(job) for job in silent)

    def resend_wake_ups(self) -> None:
        """Send wake-ups for ready jobs without one: seen twice in a row, so that one under way is not doubled."""
        with self.platform.database.reading() as session:
            ready = _ready(session)
        missing = {}
        for queue, jobs in ready.items():
            try:
                missing[queue] = max(0, jobs - self.waiting(queue))
            except (RedisError, OSError) as error:
                log.warning("broker away", queue=queue, reason=str(error))
                return
        for queue, count in missing.items():
            lost = min(count, self._quiet.get(queue, 0))
            if lost:
                self.ring(queue, lost)
                process_counters().add(WAKE_UPS_RESENT, (queue,), lost)
        self._quiet = missing

    def _look(self) -> Sequence[Job]:
        try:
            with self.platform.database.reading() as session:
                return session.scalars(RUNNING).all()
        except Exception:
            self._seen.clear()
            raise

    def _lose(self, job: Job) -> bool:
        with self.platform.database.transaction() as session:
            is_lost = lose_silent(session, job, self.platform.settings.jobs.lease_s)
        if is_lost:
            record_lost_attempt(job)
            log.warning("attempt lost", job_id=job.id, run_id=job.root_id, kind=job.kind, attempt=job.attempt)
        return is_lost


def lose_silent(session: Session, seen: Job, lease_s: float) -> bool:
    """Take the attempt from whom it was seen with for `lease_s`; false when it was heard since, or has ended.

    The job's row is locked before it is looked at: no heartbeat comes between the look and the loss.
    """
    lock_run(session, seen.root_id)
    now = session.get_one(Job, seen.id, with_for_update={"key_share": True}, populate_existing=True)
    if (now.state, now.attempt, now.heartbeats) != ("running", seen.attempt, seen.heartbeats):
        return False
    claim = Claim(seen.id, seen.root_id, seen.sequence_id, seen.kind, seen.attempt, {})
    return lose(session, claim, Failure("worker_lost", f"attempt {seen.attempt} sent no heartbeat for {lease_s:g} s"))


def _ready(session: Session) -> dict[str, int]:
    """Ready jobs per queue that is not paused, as many as are worth a wake-up."""
    paused = set(session.scalars(select(Queue.name).where(Queue.mode == "paused")))
    counted = {queue: wake_ups_wanted(session, queue) for queue in QUEUES if queue not in paused}
    return {queue: jobs for queue, jobs in counted.items() if jobs}


# Requeues jobs that a stopped platform left running, without waiting for their leases.
#
# **Conventions.** Only for whoever knows that the workers in question have ended: the embedded supervisor, which holds
# the data folder and has seen its worker end, and a worker that has killed its own processes. An attempt cut off by an
# orderly stop is given back to the job; one cut off by a crash counts.


STOPPED = Failure("platform_stopped", "the platform was stopped while this attempt ran")
WORKER_STOPPED = Failure("worker_stopped", "the worker was stopped while this attempt ran")
CRASHED = Failure("worker_lost", "the platform ended while this attempt ran")


def give_back_running(platform: Platform, failure: Failure, *, is_counted: bool) -> int:
    """Queue every running job again; `is_counted`: against its attempts. How many there were.

    A job without attempts left fails with `failure`; one that was asked to stop is cancelled.
    """
    with platform.database.reading() as session:
        running = session.scalars(RUNNING).all()
    return _interrupt_all(platform, running, failure, is_counted=is_counted)


def give_back_of(platform: Platform, workers: Sequence[str], failure: Failure) -> int:
    """Queue again what these processes ran, which have ended; it costs no attempt. How many there were.

    `workers` are their names (`worker_name`).
    """
    held = (JobAttempt.job_id == Job.id) & (JobAttempt.number == Job.attempt)
    ours = select(Job).join(JobAttempt, held).where(Job.state == "running", JobAttempt.worker.in_(workers))
    with platform.database.reading() as session:
        running = session.scalars(ours.where(Job.queue != "")).all()
    return _interrupt_all(platform, running, failure, is_counted=False)


def _interrupt_all(platform: Platform, running: Sequence[Job], failure: Failure, *, is_counted: bool) -> int:
    for job in running:
        claim = Claim(job.id, job.root_id, job.sequence_id, job.kind, job.attempt, {})
        _interrupt(platform, claim, failure, is_counted=is_counted)
    return len(running)


def _interrupt(platform: Platform, claim: Claim, failure: Failure, *, is_counted: bool) -> None:
    with platform.database.transaction() as session:
        lock_run(session, claim.root_id)
        if not is_counted:
            held = update(Job).where(Job.id == claim.job_id, Job.state == "running", Job.attempt == claim.attempt)
            rows_changed(session, held.values(attempts_left=Job.attempts_left + 1))
        lose(session, claim, failure)
