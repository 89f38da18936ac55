"""What died is taken up again, what lives is left alone, whatever the clocks say; also at the next start."""

import pytest
from redis import ConnectionError as RedisConnectionError
from sqlalchemy import select, update
from sqlalchemy.exc import OperationalError

from services.runtime.database.transactions import Database
from services.runtime.jobs import claims
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.lease_sweep import CRASHED, STOPPED, Sweeper, give_back_running, lose_silent
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Job, JobAttempt, base
from services.runtime.platform import Platform
from tests.services.runtime.jobs.outages import GONE
from tests.services.runtime.jobs.steps import a_job, a_run, act, an_owner, claimed, job, run_all, states


class WakeUps:
    """A broker whose queues can be read and emptied."""

    def __init__(self) -> None:
        self.in_queue: dict[str, int] = {}

    def ring(self, queue: str, times: int) -> None:
        self.in_queue[queue] = self.in_queue.get(queue, 0) + times

    def waiting(self, queue: str) -> int:
        return self.in_queue.get(queue, 0)


class Clock:
    """A monotonic clock that moves when told."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def a_sweeper(platform: Platform, clock: Clock, bells: WakeUps | None = None) -> Sweeper:
    bells = bells or WakeUps()
    return Sweeper(platform, bells.waiting, bells.ring, clock)


def silence(platform: Platform, sweeper: Sweeper, clock: Clock) -> int:
    """Let a lease pass; how many attempts were given back."""
    sweeper.recover()
    clock.now_s += platform.settings.jobs.lease_s
    return sweeper.recover()


def test_an_attempt_silent_for_a_lease_is_queued_again(platform_on: Platform) -> None:
    clock = Clock()
    a_job(platform_on, an_owner(platform_on))
    job_id = claimed(platform_on).job_id
    assert silence(platform_on, a_sweeper(platform_on, clock), clock) == 1
    assert job(platform_on, job_id).state == "queued"
    run_all(platform_on)
    assert (job(platform_on, job_id).state, job(platform_on, job_id).attempt) == ("succeeded", 2)


def test_an_attempt_that_beats_is_left_alone_however_long_it_takes(platform: Platform) -> None:
    clock = Clock()
    sweeper = a_sweeper(platform, clock)
    a_job(platform, an_owner(platform))
    job_id = claimed(platform).job_id
    for _ in range(10):
        sweeper.recover()
        clock.now_s += platform.settings.jobs.lease_s * 0.9
        with platform.database.transaction() as session:
            session.execute(update(Job).where(Job.id == job_id).values(heartbeats=Job.heartbeats + 1))
    assert job(platform, job_id).state == "running"


def test_a_job_whose_every_worker_dies_fails_as_worker_lost_and_its_run_too(platform: Platform) -> None:
    clock = Clock()
    sweeper = a_sweeper(platform, clock)
    root = a_run(platform, an_owner(platform), JobSpec("ingest.ok", key="a"), JobSpec("ingest.ok", needs=("a",)))
    for _ in range(3):
        claimed(platform)
        silence(platform, sweeper, clock)
    failed = job(platform, root)
    assert (failed.state, failed.failure_code) == ("failed", "worker_lost")
    assert states(platform, root) == {"failed": 1, "cancelled": 1}


@pytest.mark.parametrize("jump_ns", [-(10**18), 10**18], ids=["back 30 years", "on 30 years"])
def test_a_clock_that_is_set_back_or_on_loses_and_doubles_nothing(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch, jump_ns: int
) -> None:
    clock = Clock()
    sweeper = a_sweeper(platform_on, clock)
    owner = an_owner(platform_on)
    first, second = a_job(platform_on, owner), a_job(platform_on, owner)
    assert claimed(platform_on).job_id == first
    sweeper.recover()
    shifted = base.now_ns() + jump_ns
    for module in (base, claims):
        monkeypatch.setattr(module, "now_ns", lambda: shifted)
    assert sweeper.recover() == 0, "the worker lives; its lease does not hang on the wall clock"
    assert run_all(platform_on) == 1
    assert job(platform_on, second).state == "succeeded"
    clock.now_s += platform_on.settings.jobs.lease_s
    assert sweeper.recover() == 1
    assert run_all(platform_on) == 1
    assert job(platform_on, first).state == "succeeded"


def test_an_attempt_that_was_lost_once_is_counted_once(platform_on: Platform) -> None:
    """The second sweeper's look was before the first one's act."""
    clock = Clock()
    a_job(platform_on, an_owner(platform_on))
    seen = job(platform_on, claimed(platform_on).job_id)
    lost = []
    for _ in range(2):
        with platform_on.database.transaction() as session:
            lost.append(lose_silent(session, seen, platform_on.settings.jobs.lease_s))
    assert lost == [True, False]
    assert a_sweeper(platform_on, clock).recover() == 0


def test_an_attempt_that_is_heard_while_it_is_being_lost_is_kept(platform_on: Platform) -> None:
    a_job(platform_on, an_owner(platform_on))
    seen = job(platform_on, claimed(platform_on).job_id)
    with platform_on.database.transaction() as session:
        session.execute(update(Job).where(Job.id == seen.id).values(heartbeats=Job.heartbeats + 1))
    with platform_on.database.transaction() as session:
        assert not lose_silent(session, seen, platform_on.settings.jobs.lease_s)
    assert job(platform_on, seen.id).state == "running"


def test_a_sweeper_that_could_not_look_takes_no_job_from_anybody_as_it_looks_again(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an outage longer than a lease nobody can be heard; who lives says so within a lease after it."""
    clock = Clock()
    sweeper = a_sweeper(platform, clock)
    a_job(platform, an_owner(platform))
    job_id = claimed(platform).job_id
    sweeper.recover()
    with monkeypatch.context() as outage:
        outage.setattr(Database, "reading", lambda database: (_ for _ in ()).throw(GONE))
        clock.now_s += 1.0
        with pytest.raises(OperationalError):
            sweeper.recover()
    clock.now_s += platform.settings.jobs.lease_s
    assert sweeper.recover() == 0
    clock.now_s += platform.settings.jobs.lease_s * 0.9
    assert (sweeper.recover(), job(platform, job_id).state) == (0, "running")
    assert silence(platform, sweeper, clock) == 1


def test_a_lost_wake_up_is_sent_again_and_none_is_doubled(platform: Platform) -> None:
    bells, clock = WakeUps(), Clock()
    sweeper = a_sweeper(platform, clock, bells)
    owner = an_owner(platform)
    for _ in range(3):
        a_job(platform, owner)
    bells.ring("ingest", 1)
    for _ in range(5):
        sweeper.sweep()
    assert bells.in_queue == {"ingest": 3}


def test_nothing_is_rung_for_a_paused_queue(platform: Platform) -> None:
    bells = WakeUps()
    sweeper = a_sweeper(platform, Clock(), bells)
    a_job(platform, an_owner(platform))
    act(platform, set_mode, "ingest", "paused")
    sweeper.sweep()
    sweeper.sweep()
    assert bells.in_queue == {}


def test_a_broker_that_is_away_stops_no_sweep(platform: Platform) -> None:
    def away(_queue: str) -> int:
        raise RedisConnectionError("refused")

    clock = Clock()
    sweeper = Sweeper(platform, away, WakeUps().ring, clock)
    owner = an_owner(platform)
    job_id = a_job(platform, owner)
    a_job(platform, owner)
    claimed(platform)
    sweeper.sweep()
    clock.now_s += platform.settings.jobs.lease_s
    sweeper.sweep()
    assert job(platform, job_id).state == "queued"


def test_bells_ring_after_the_commit_and_never_for_what_was_rolled_back(platform: Platform) -> None:
    rung: list[tuple[str, int]] = []
    database = Database(platform.settings, lambda queue, times: rung.append((queue, times)))
    loud = Platform(platform.settings, database, platform.store)
    owner = an_owner(loud)
    a_job(loud, owner)
    assert rung == [("ingest", 1)]

    def change_its_mind() -> None:
        with loud.database.transaction() as session:
            enqueue(session, JobSpec("ingest.ok"), Context(owner))
            raise RuntimeError("changed its mind")

    with pytest.raises(RuntimeError, match="changed its mind"):
        change_its_mind()
    assert rung == [("ingest", 1)]
    assert run_all(loud) == 1
    database.close()


def test_an_orderly_stop_costs_no_attempt_however_often(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform))
    for _ in range(5):
        claimed(platform)
        assert give_back_running(platform, STOPPED, is_counted=False) == 1
        assert (job(platform, job_id).state, job(platform, job_id).attempts_left) == ("queued", 3)
    run_all(platform)
    assert job(platform, job_id).state == "succeeded"


def test_a_crash_counts_and_the_third_is_the_last(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform))
    for left in (2, 1):
        claimed(platform)
        give_back_running(platform, CRASHED, is_counted=True)
        assert (job(platform, job_id).state, job(platform, job_id).attempts_left) == ("queued", left)
    claimed(platform)
    give_back_running(platform, CRASHED, is_counted=True)
    assert (job(platform, job_id).state, job(platform, job_id).failure_code) == ("failed", "worker_lost")


def test_the_attempt_says_why_it_ended_and_a_wake_up_is_sent(platform: Platform, bells: list[tuple[str, int]]) -> None:
    job_id = a_job(platform, an_owner(platform))
    claimed(platform)
    bells.clear()
    give_back_running(platform, STOPPED, is_counted=False)
    assert bells == [("ingest", 1)]
    with platform.database.reading() as session:
        (attempt,) = session.scalars(select(JobAttempt).where(JobAttempt.job_id == job_id))
    assert (attempt.outcome, attempt.failure_code) == ("lost", "platform_stopped")
