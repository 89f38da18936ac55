"""Who takes which job: one taker each, urgent first, owners in turn, nothing from a paused queue."""

from collections import Counter
from threading import Barrier, Thread

from sqlalchemy import update

from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.instrumentation import origin_of
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Job
from services.runtime.platform import Platform
from tests.services.runtime.jobs.steps import a_job, an_owner, job, run_all


def take(platform: Platform) -> str:
    with platform.database.transaction() as session:
        taken = claim(session, "ingest")
    assert taken is not None
    return taken.job_id


def test_eight_workers_that_receive_the_same_wake_up_take_each_job_once(platform_on: Platform) -> None:
    owner = an_owner(platform_on)
    jobs = [a_job(platform_on, owner) for _ in range(12)]
    taken: Counter[str] = Counter()
    together = Barrier(8)

    def work() -> None:
        together.wait()
        for _ in range(4):
            with platform_on.database.transaction() as session:
                mine = claim(session, "ingest")
            if mine:
                taken[mine.job_id] += 1

    threads = [Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert taken == Counter(jobs)


def test_a_wake_up_received_twice_does_the_work_once(platform_on: Platform) -> None:
    calls: list[str] = []

    def count(attempt: Attempt) -> Outcome:
        calls.append(attempt.job_id)
        return Outcome()

    a_job(platform_on, an_owner(platform_on), "ingest.count")
    assert run_next(platform_on, "ingest", {"ingest.count": count})
    assert not run_next(platform_on, "ingest", {"ingest.count": count})
    assert len(calls) == 1


def test_the_urgent_job_is_taken_before_the_older(platform: Platform) -> None:
    owner = an_owner(platform)
    patient = a_job(platform, owner)
    urgent = a_job(platform, owner, priority=5)
    assert [take(platform), take(platform)] == [urgent, patient]


def test_an_owner_with_a_hundred_jobs_does_not_starve_the_next(platform_on: Platform) -> None:
    greedy, modest = an_owner(platform_on, "greedy"), an_owner(platform_on, "modest")
    first = [a_job(platform_on, greedy) for _ in range(20)]
    only = a_job(platform_on, modest)
    assert [take(platform_on), take(platform_on)] == [first[0], only]


def test_a_paused_queue_gives_nothing_until_it_is_opened(platform_on: Platform) -> None:
    job_id = a_job(platform_on, an_owner(platform_on))
    with platform_on.database.transaction() as session:
        set_mode(session, "ingest", "paused")
    assert run_all(platform_on) == 0
    with platform_on.database.transaction() as session:
        set_mode(session, "ingest", "open")
    run_all(platform_on)
    assert job(platform_on, job_id).state == "succeeded"


def test_how_long_a_job_was_ready_before_it_was_claimed_is_known_once_it_is(platform: Platform) -> None:
    queued_id = a_job(platform, an_owner(platform))
    with platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == queued_id).values(ready_ns=Job.ready_ns - 3 * 10**9))
    with platform.database.transaction() as session:
        taken = claim(session, "ingest")
        assert taken is not None
        waited_s = origin_of(session, taken).waited_s
    assert waited_s is not None
    assert 3.0 <= waited_s < 600.0
    with platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == taken.job_id).values(ready_ns=None))
        assert origin_of(session, taken).waited_s is None
