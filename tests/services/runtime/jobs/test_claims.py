"""Who takes which job: one taker each, urgent first, owners in turn, nothing from a paused queue.

Whose turn it is, is compared with a plain reckoning, and little of a long history is read for it.
"""

import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event, insert, text, update
from sqlalchemy.orm import Session

from benchmarks.rows.plans import explained, record_statements
from services.runtime.jobs import execution
from services.runtime.jobs.claims import claim, owners_waiting
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.execution import run_next, run_row
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.orm import Job, User
from services.runtime.orm.base import new_id
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from testing.servers.fixtures import Bells, make_settings, opened
from testing.threads import at_once
from tests.services.runtime.jobs.steps import HANDLERS, a_job, a_run, act, an_owner, claimed, job, run_all, states


def test_eight_workers_that_receive_the_same_wake_up_take_each_job_once(platform_on: Platform) -> None:
    owner = an_owner(platform_on)
    jobs = [a_job(platform_on, owner) for _ in range(12)]
    taken: list[str] = []

    def work(_number: int) -> None:
        for _ in range(4):
            with platform_on.database.transaction() as session:
                mine = claim(session, "ingest")
            if mine:
                taken.append(mine.job_id)

    at_once(8, work)
    assert sorted(taken) == sorted(jobs)


def test_a_wake_up_received_twice_does_the_work_once(platform: Platform) -> None:
    calls: list[str] = []

    def count(attempt: Attempt) -> Outcome:
        calls.append(attempt.job_id)
        return Outcome()

    a_job(platform, an_owner(platform), "ingest.count")
    assert run_next(platform, "ingest", {"ingest.count": count})
    assert not run_next(platform, "ingest", {"ingest.count": count})
    assert len(calls) == 1


@pytest.fixture
def long_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs count as short however busy the machine is."""
    monkeypatch.setattr(execution, "ROW_S", 1e6)


@pytest.mark.usefixtures("long_rows")
def test_short_jobs_are_run_in_a_row_each_taken_with_the_end_of_the_one_before(
    platform: Platform, bells: Bells
) -> None:
    owner = an_owner(platform)
    jobs = [a_job(platform, owner) for _ in range(3)]
    bells.clear()
    with transactions_of(platform) as begun:
        assert run_row(platform, "ingest", HANDLERS, lambda: True) == 3
    assert len(begun) == 4, "one that takes the first, and an end each"
    assert [job(platform, one).state for one in jobs] == ["succeeded"] * 3
    assert bells == [("ingest", -1), ("ingest", -1)], "the first one's wake-up was received"


@pytest.mark.usefixtures("long_rows")
def test_a_job_that_is_taken_by_who_made_it_ready_wakes_nobody(platform: Platform, bells: Bells) -> None:
    run_id = a_run(
        platform, an_owner(platform), JobSpec("ingest.ok", key="first"), JobSpec("ingest.ok", needs=("first",))
    )
    bells.clear()
    assert run_row(platform, "ingest", HANDLERS, lambda: True) == 2
    assert (states(platform, run_id), bells) == ({"succeeded": 2}, [])
    assert job(platform, run_id).state == "succeeded"


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
    assert [claimed(platform).job_id, claimed(platform).job_id] == [urgent, patient]


def test_an_owner_with_a_hundred_jobs_does_not_starve_the_next(platform: Platform) -> None:
    greedy, modest = an_owner(platform, "greedy"), an_owner(platform, "modest")
    first = [a_job(platform, greedy) for _ in range(20)]
    only = a_job(platform, modest)
    assert [claimed(platform).job_id, claimed(platform).job_id] == [first[0], only]


def test_a_paused_queue_gives_nothing_until_it_is_opened(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform))
    act(platform, set_mode, "ingest", "paused")
    assert run_all(platform) == 0
    act(platform, set_mode, "ingest", "open")
    run_all(platform)
    assert job(platform, job_id).state == "succeeded"


def test_how_long_a_job_was_ready_before_it_was_claimed_is_known_once_it_is(platform: Platform) -> None:
    queued_id = a_job(platform, an_owner(platform))
    with platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == queued_id).values(ready_ns=Job.ready_ns - 3 * 10**9))
    taken = claimed(platform)
    assert taken.origin.waited_s is not None
    assert 3.0 <= taken.origin.waited_s < 600.0


@dataclass(frozen=True)
class JobState:
    """What decides on a job's turn."""

    owner_id: str
    root_id: str
    queue: str
    state: str
    needs_left: int
    priority: int

    def row(self) -> dict[str, Any]:
        return {"id": new_id(), "kind": f"{self.queue}.nothing", **vars(self)}


def owners(session: Session, count: int) -> list[str]:
    rows = [User(name=f"owner-{number}", role="curator") for number in range(count)]
    session.add_all(rows)
    session.flush()
    return [row.id for row in rows]


def filled(session: Session, jobs: Sequence[JobState]) -> None:
    roots = {one.root_id: one.owner_id for one in jobs}
    runs = [{"id": root, "root_id": root, "owner_id": owner, "kind": "run"} for root, owner in roots.items()]
    session.execute(insert(Job), runs)
    session.execute(insert(Job), [one.row() for one in jobs])


def reckoned(jobs: Sequence[JobState], queue: str) -> list[tuple[str, int, int, str]]:
    """By the sentence of `owners_waiting`."""
    here = [one for one in jobs if one.queue == queue]
    found = []
    for owner in {one.owner_id for one in here}:
        mine = [one for one in here if one.owner_id == owner]
        ready = [one for one in mine if one.state == "queued" and one.needs_left == 0]
        if ready:
            urgency = max(one.priority for one in ready)
            oldest = min(one.root_id for one in ready if one.priority == urgency)
            found.append((owner, urgency, sum(one.state == "running" for one in mine), oldest))
    return sorted(found, key=lambda one: (-one[1], one[2], one[3]))


def test_whose_turn_it_is_is_what_a_plain_reckoning_says(platform_on: Platform) -> None:
    chance = random.Random(22)
    with platform_on.database.transaction() as session:
        ids = owners(session, 7)
        runs = [(new_id(), chance.choice(ids[:6])) for _ in range(20)]
        jobs = [
            JobState(owner, root, *(chance.choice(of) for of in (("ingest", "eval"), STATES, (0, 0, 1), (0, 5, 9))))
            for root, owner in chance.choices(runs, k=150)
        ]
        filled(session, jobs)
        for queue in ("ingest", "eval", "labeler"):
            assert [tuple(row) for row in owners_waiting(queue).rows(session, {})] == reckoned(jobs, queue)


STATES = ("queued", "queued", "running", "succeeded")


@pytest.mark.usefixtures("long_rows")
def test_ends_and_claims_are_planned_once_and_ask_for_little(tmp_path: Path, fresh_postgres_url: str) -> None:
    """psycopg prepares a statement at its sixth execution, PostgreSQL keeps its plan from the sixth one after that."""
    platform = opened(make_settings(tmp_path, database=DatabaseSettings(fresh_postgres_url, pool_size=1)), [])
    a_run(platform, an_owner(platform), *[JobSpec("ingest.ok") for _ in range(1000)])
    with platform.database.transaction() as session:
        session.execute(text("ANALYZE"))
    more = iter(range(19))
    with record_statements(platform.database.engine) as statements:
        assert run_row(platform, "ingest", HANDLERS, lambda: next(more, None) is not None) == 20
    with platform.database.reading() as session:
        planned = {sql: kept for sql, kept in session.execute(text(PLANS)) if kept}
    platform.database.close()
    assert len([sql for sql in planned if "SKIP LOCKED" in sql]) == 1
    assert [sql for sql in planned if "RECURSIVE" in sql]
    assert len(statements) < 20 * 7 + 10, "two for a claim, five for an end without words"


PLANS = "SELECT statement, generic_plans FROM pg_prepared_statements"


def test_however_long_the_history_few_of_its_rows_are_read(on_postgres: Platform) -> None:
    with on_postgres.database.transaction() as session:
        ids = owners(session, 4)
        ended = [JobState(ids[0], new_id(), "ingest", "succeeded", 0, 0) for _ in range(2000)]
        waiting = [JobState(ids[number % 4], new_id(), "ingest", "queued", 0, 0) for number in range(2000)]
        filled(session, ended + waiting)
    with on_postgres.database.transaction() as session:
        session.execute(text("ANALYZE"))
    with record_statements(on_postgres.database.engine) as statements, on_postgres.database.reading() as session:
        assert len(owners_waiting("ingest").rows(session, {})) == 4
    with on_postgres.database.engine.connect() as connection:
        plan = explained(connection, statements[-1], frozenset({"jobs"}))
    assert plan.rows_read is not None
    assert plan.rows_read <= 5 * 4
