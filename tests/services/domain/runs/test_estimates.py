"""The one estimate of the time left, read from the database."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from sqlalchemy import event, select
from sqlalchemy.orm import Session

from services.domain.runs.estimates import time_left
from services.runtime.database.clock import database_ns
from services.runtime.jobs.control import retry, set_mode
from services.runtime.orm import Job, Worker
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import row_of, run

SECOND = 10**9
STAGES = ("ingest.synchronise", "labeler.fuse", "labeler.surface", "labeler.reference")


@pytest.fixture
def ada(platform: Platform) -> Person:
    return person(platform, "curator")


def worked(platform: Platform, run_id: str, done: int, each_s: int = 40) -> None:
    """As workers would write it down: the first `done` stages took `each_s` each, and the run goes on."""
    with platform.database.transaction() as session:
        jobs = session.scalars(select(Job).where(Job.root_id == run_id, Job.queue != "").order_by(Job.id)).all()
        at_ns = now_ns() - each_s * done * SECOND
        root = session.get_one(Job, run_id)
        root.state, root.started_ns = ("succeeded" if done == len(jobs) else "running"), at_ns
        for job in jobs[:done]:
            job.state, job.started_ns, job.finished_ns = "succeeded", at_ns, at_ns + each_s * SECOND
            at_ns += each_s * SECOND
        root.finished_ns = at_ns if root.state == "succeeded" else None


def left_s(platform: Platform, run_id: str) -> int | None:
    with platform.database.reading() as session:
        return time_left(session, [run_id]).get(run_id)


@contextmanager
def counted(session: Session) -> Iterator[list[str]]:
    """The statements that are executed meanwhile."""
    statements: list[str] = []

    def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        statements.append(statement)

    engine = session.get_bind()
    event.listen(engine, "before_cursor_execute", note)
    yield statements
    event.remove(engine, "before_cursor_execute", note)


def test_a_first_run_is_told_by_what_is_typical_and_later_ones_by_what_such_runs_took(
    platform: Platform, ada: Person
) -> None:
    first = run(platform, ada, *STAGES)
    worked(platform, first, 0)
    before_s = left_s(platform, first)
    assert before_s
    worked(platform, first, len(STAGES), each_s=400)
    assert left_s(platform, first) is None
    second = run(platform, ada, *STAGES)
    worked(platform, second, 0)
    told_s = left_s(platform, second)
    assert told_s
    assert told_s > 10 * before_s


def test_a_run_that_is_queued_again_is_not_told_to_be_shorter_than_what_it_has_to_do(
    platform: Platform, ada: Person
) -> None:
    """Half is done; what is done was divided by the time since it was queued again, a moment ago."""
    run_id = run(platform, ada, *STAGES)
    worked(platform, run_id, 2, each_s=100)
    before_s = left_s(platform, run_id)
    with platform.database.transaction() as session:
        root = session.get_one(Job, run_id)
        root.state = "failed"
        session.flush()
        retry(session, run_id, 3)
        root.state, root.started_ns = "running", now_ns()
    assert before_s
    assert left_s(platform, run_id) == before_s


def test_with_more_workers_it_takes_less_and_beside_another_owner_more(platform: Platform, ada: Person) -> None:
    run_id = run(platform, ada, *STAGES, *["labeler.frames"] * 4)
    worked(platform, run_id, 1)
    alone_s = left_s(platform, run_id)
    assert alone_s
    with platform.database.transaction() as session:
        for number in range(2):
            worker = Worker(name=f"w:{number}", queues="ingest,labeler", started_ns=1, beat_ns=database_ns())
            session.add(worker)
    two_s = left_s(platform, run_id)
    assert two_s
    assert two_s < alone_s
    other = run(platform, person(platform, "curator"), "labeler.fuse")
    assert row_of(platform, other).state == "queued"
    assert left_s(platform, run_id) == alone_s


def test_an_older_run_of_the_same_owner_is_done_first(platform: Platform, ada: Person) -> None:
    older, newer = (run(platform, ada, *STAGES) for _ in range(2))
    with platform.database.reading() as session:
        told = time_left(session, [older, newer])
    assert told[newer] > told[older]
    assert left_s(platform, newer) == told[newer], "alone it is told the same as in a list"


def test_nothing_is_told_of_a_job_within_a_run_nor_while_its_queue_is_paused(platform: Platform, ada: Person) -> None:
    run_id = run(platform, ada, *STAGES)
    worked(platform, run_id, 1)
    with platform.database.reading() as session:
        children = session.scalars(select(Job.id).where(Job.root_id == run_id, Job.id != run_id)).all()
        assert time_left(session, children) == {}
    with platform.database.transaction() as session:
        set_mode(session, "labeler", "paused")
    assert left_s(platform, run_id) is None


def test_fifty_runs_are_told_with_as_many_statements_as_one(platform: Platform, ada: Person) -> None:
    runs = [run(platform, ada, *STAGES) for _ in range(50)]
    for run_id in runs:
        worked(platform, run_id, 1)
    with platform.database.reading() as session:
        session.connection()  # which begins its transaction, once
        with counted(session) as of_one:
            time_left(session, runs[:1])
        with counted(session) as of_all:
            assert len(time_left(session, runs)) == len(runs)
    assert len(of_all) == len(of_one)
