"""Recovery of jobs: requeues attempts with expired leases, resends lost wake-ups.

**Conventions.** A sweeper stores when, on its own monotonic clock, the heartbeats of an attempt last changed. If they
did not change for a lease, the job is requeued, or fails as `worker_lost` if no attempt is left. Clocks of different
machines are never compared. After a database outage every attempt gets a new lease, because the sweeper could not see
its heartbeats. Several sweepers may run; each change is a compare-and-set, so they do nothing twice.
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
    """`sweep()` runs about every second; `waiting(queue)` counts wake-ups not yet received, `ring` sends more."""

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
        """Requeue every attempt without heartbeats for a lease; return their number."""
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
        """Send wake-ups for jobs that were ready without one twice in a row, so that none in transit is duplicated."""
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
    """Requeue an attempt that was silent for `lease_s`; return False if it sent a heartbeat or ended since.

    The job's row is locked before the check, so that no heartbeat comes between check and requeueing.
    """
    lock_run(session, seen.root_id)
    now = session.get_one(Job, seen.id, with_for_update={"key_share": True}, populate_existing=True)
    if (now.state, now.attempt, now.heartbeats) != ("running", seen.attempt, seen.heartbeats):
        return False
    claim = Claim(seen.id, seen.root_id, seen.sequence_id, seen.kind, seen.attempt, {})
    return lose(session, claim, Failure("worker_lost", f"attempt {seen.attempt} sent no heartbeat for {lease_s:g} s"))


def _ready(session: Session) -> dict[str, int]:
    """Return the ready jobs per open queue, limited to the useful number of wake-ups."""
    paused = set(session.scalars(select(Queue.name).where(Queue.mode == "paused")))
    counted = {queue: wake_ups_wanted(session, queue) for queue in QUEUES if queue not in paused}
    return {queue: jobs for queue, jobs in counted.items() if jobs}


# Requeues jobs that a stopped platform left running, without waiting for their leases. Use it only if the workers have
# certainly ended. The embedded supervisor holds the data folder and has seen its worker end; a worker may have killed
# its own processes. An attempt interrupted by an orderly stop does not count; an attempt interrupted by a crash counts.


STOPPED = Failure("platform_stopped", "the platform was stopped while this attempt ran")
WORKER_STOPPED = Failure("worker_stopped", "the worker was stopped while this attempt ran")
CRASHED = Failure("worker_lost", "the platform ended while this attempt ran")


def give_back_running(platform: Platform, failure: Failure, *, is_counted: bool) -> int:
    """Queue every running job again; `is_counted`: count the attempt. Return the number of jobs.

    A job without attempts left fails with `failure`; a cancelled job ends as cancelled.
    """
    with platform.database.reading() as session:
        running = session.scalars(RUNNING).all()
    return _interrupt_all(platform, running, failure, is_counted=is_counted)


def give_back_of(platform: Platform, workers: Sequence[str], failure: Failure) -> int:
    """Queue the jobs of these ended processes again without counting the attempt; return their number.

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
