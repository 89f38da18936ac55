"""Whose turn it is, against a plain reckoning; and how little of a long history is read for it."""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import insert, text
from sqlalchemy.orm import Session

from benchmarks.rows.plans import explained, taken_down
from services.runtime.jobs.execution import run_row
from services.runtime.jobs.readiness import owners_waiting
from services.runtime.jobs.specs import JobSpec
from services.runtime.orm import Job, User
from services.runtime.orm.base import new_id
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from testing.servers.fixtures import make_settings, opened
from tests.services.runtime.jobs.steps import HANDLERS, a_run, an_owner


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
    roots = {job.root_id: job.owner_id for job in jobs}
    runs = [{"id": root, "root_id": root, "owner_id": owner, "kind": "run"} for root, owner in roots.items()]
    session.execute(insert(Job), runs)
    session.execute(insert(Job), [job.row() for job in jobs])


def reckoned(jobs: Sequence[JobState], queue: str) -> list[tuple[str, int, int, str]]:
    """By the sentence of `owners_waiting`."""
    here = [job for job in jobs if job.queue == queue]
    found = []
    for owner in {job.owner_id for job in here}:
        mine = [job for job in here if job.owner_id == owner]
        ready = [job for job in mine if job.state == "queued" and job.needs_left == 0]
        if ready:
            urgency = max(job.priority for job in ready)
            oldest = min(job.root_id for job in ready if job.priority == urgency)
            found.append((owner, urgency, sum(job.state == "running" for job in mine), oldest))
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


def test_ends_and_claims_are_planned_once_and_ask_for_little(tmp_path: Path, fresh_postgres_url: str) -> None:
    """psycopg prepares a statement at its sixth execution, PostgreSQL keeps its plan from the sixth one after that."""
    platform = opened(make_settings(tmp_path, database=DatabaseSettings(fresh_postgres_url, pool_size=1)), [])
    a_run(platform, an_owner(platform), *[JobSpec("ingest.ok") for _ in range(1000)])
    with platform.database.transaction() as session:
        session.execute(text("ANALYZE"))
    more = iter(range(19))
    with taken_down(platform.database.engine) as statements:
        assert run_row(platform, "ingest", HANDLERS, lambda: next(more, None) is not None) == 20
    with platform.database.reading() as session:
        planned = {sql: kept for sql, kept in session.execute(text(PLANS)) if kept}
    platform.database.close()
    assert len([sql for sql in planned if "SKIP LOCKED" in sql]) == 1
    assert [sql for sql in planned if "RECURSIVE" in sql]
    assert len(statements) < 20 * 7 + 10, "two for a claim, five for an end without words"


PLANS = "SELECT statement, generic_plans FROM pg_prepared_statements"


def test_however_long_the_history_few_of_its_rows_are_read(tmp_path: Path, fresh_postgres_url: str) -> None:
    platform = opened(make_settings(tmp_path, database=DatabaseSettings(fresh_postgres_url)), [])
    with platform.database.transaction() as session:
        ids = owners(session, 4)
        ended = [JobState(ids[0], new_id(), "ingest", "succeeded", 0, 0) for _ in range(2000)]
        waiting = [JobState(ids[number % 4], new_id(), "ingest", "queued", 0, 0) for number in range(2000)]
        filled(session, ended + waiting)
    with platform.database.transaction() as session:
        session.execute(text("ANALYZE"))
    with taken_down(platform.database.engine) as statements, platform.database.reading() as session:
        assert len(owners_waiting("ingest").rows(session, {})) == 4
    with platform.database.engine.connect() as connection:
        plan = explained(connection, statements[-1], frozenset({"jobs"}))
    platform.database.close()
    assert plan.rows_read is not None
    assert plan.rows_read <= 5 * 4
