"""Who takes which job: one taker each, urgent first, owners in turn, nothing from a paused queue."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Barrier, Thread

import pytest
from sqlalchemy import event, update

from services.runtime.jobs import execution
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.execution import run_next, run_row
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.orm import Job
from services.runtime.platform import Platform
from testing.servers.fixtures import Bells
from tests.services.runtime.jobs.steps import HANDLERS, a_job, a_run, an_owner, job, run_all, states


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


@pytest.fixture
def long_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs count as short however busy the machine is."""
    monkeypatch.setattr(execution, "ROW_S", 1e6)


@pytest.mark.usefixtures("long_rows")
def test_short_jobs_are_run_in_a_row_each_taken_with_the_end_of_the_one_before(
    platform_on: Platform, bells: Bells
) -> None:
    owner = an_owner(platform_on)
    jobs = [a_job(platform_on, owner) for _ in range(3)]
    bells.clear()
    with transactions_of(platform_on) as begun:
        assert run_row(platform_on, "ingest", HANDLERS, lambda: True) == 3
    assert len(begun) == 4, "one that takes the first, and an end each"
    assert [job(platform_on, one).state for one in jobs] == ["succeeded"] * 3
    assert bells == [("ingest", -1), ("ingest", -1)], "the first one's wake-up was received"


@pytest.mark.usefixtures("long_rows")
def test_a_job_that_is_taken_by_who_made_it_ready_wakes_nobody(platform_on: Platform, bells: Bells) -> None:
    run_id = a_run(
        platform_on, an_owner(platform_on), JobSpec("ingest.ok", key="first"), JobSpec("ingest.ok", needs=("first",))
    )
    bells.clear()
    assert run_row(platform_on, "ingest", HANDLERS, lambda: True) == 2
    assert (states(platform_on, run_id), bells) == ({"succeeded": 2}, [])
    assert job(platform_on, run_id).state == "succeeded"


@pytest.mark.usefixtures("long_rows")
def test_a_row_of_jobs_ends_when_its_worker_is_to_stop_or_other_queues_wait(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = an_owner(platform)
    for _ in range(3):
        a_job(platform, owner)
    answers = iter((True, False))
    assert run_row(platform, "ingest", HANDLERS, lambda: next(answers)) == 2
    monkeypatch.setattr(execution, "ROW_S", -1.0)
    assert run_row(platform, "ingest", HANDLERS, lambda: True) == 1


@contextmanager
def transactions_of(platform: Platform) -> Iterator[list[object]]:
    """A list that holds one for each transaction that was begun meanwhile."""
    begun: list[object] = []

    def note(connection: object) -> None:
        begun.append(connection)

    event.listen(platform.database.engine, "begin", note)
    yield begun
    event.remove(platform.database.engine, "begin", note)


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
    assert taken.origin.waited_s is not None
    assert 3.0 <= taken.origin.waited_s < 600.0
