"""Whatever happens in whatever order, a run is consistent: random histories, checked after every step."""

import random
from collections.abc import Callable

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.jobs import completion
from services.runtime.jobs.claims import Claim, claim
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.control import cancel, retry, terminate
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import TERMINAL, JobSpec, Outcome
from services.runtime.orm import Job, JobNeed
from services.runtime.platform import Platform
from tests.services.runtime.jobs.steps import a_run, an_owner

Shown = dict[str, tuple[int, tuple[object, ...]]]
FAILURE = Failure("odd", "as the dice fell")
MOST_JOBS = 30


class History:
    """Plays random steps on one run and keeps the claims that were ever handed out, dead ones too."""

    def __init__(self, platform: Platform, seed: int) -> None:
        self.dice, self.platform = random.Random(seed), platform
        self.jobs = self.dice.choice((1, 2, 6))
        specs = [JobSpec("ingest.ok", key=str(n), needs=self._earlier(n)) for n in range(self.jobs)]
        self.root = a_run(platform, an_owner(platform), *specs)
        self.claims: list[Claim] = []

    def _earlier(self, number: int) -> tuple[str, ...]:
        return tuple(str(other) for other in range(number) if self.dice.random() < 0.4)

    def step(self) -> None:
        end = self.dice.choice((self.take, self.take, self.succeed, self.succeed, self.fail, self.lose, self.steer))
        with self.platform.database.transaction() as session:
            end(session)

    def take(self, session: Session) -> None:
        taken = claim(session, "ingest")
        if taken:
            self.claims.append(taken)

    def succeed(self, session: Session) -> None:
        grows = self.dice.random() < 0.2 and session.query(Job).count() < MOST_JOBS
        then = (JobSpec("ingest.ok", key="x"), JobSpec("ingest.ok", needs=("x",))) if grows else ()
        if self._with_a_claim(lambda taken: completion.succeed(session, taken, Outcome(then=then), 3)):
            self.jobs += len(then)

    def fail(self, session: Session) -> None:
        if self.dice.random() < 0.3:
            self._with_a_claim(lambda taken: completion.fail(session, taken, FAILURE))

    def lose(self, session: Session) -> None:
        self._with_a_claim(lambda taken: completion.lose(session, taken, FAILURE))

    def steer(self, session: Session) -> None:
        act = self.dice.choice((cancel, terminate, retry, retry, retry))
        try:
            act(session, self.root, 3 if act is retry else "as the dice fell")  # type: ignore[operator]
        except JobStateError:
            assert session.get_one(Job, self.root).state in (
                TERMINAL if act is not retry else ("queued", "running", "succeeded")
            )

    def _with_a_claim(self, end: Callable[[Claim], bool]) -> bool:
        return bool(self.claims) and end(self.dice.choice(self.claims))


def assert_consistent(session: Session, root_id: str) -> None:
    run = session.get_one(Job, root_id)
    jobs = {job.id: job for job in session.scalars(select(Job).where(Job.root_id == root_id, Job.id != root_id))}
    states = {job.state for job in jobs.values()}
    is_over = not states & {"queued", "running"}
    assert (run.state in TERMINAL) == is_over, (run.state, states)
    if run.state == "succeeded":
        assert states == {"succeeded"}
    if run.state == "failed":
        assert run.failure_code
    needs: dict[str, int] = dict.fromkeys(jobs, 0)
    for need in session.scalars(select(JobNeed)):
        needs[need.job_id] += jobs[need.needed_id].state != "succeeded"
    for job in jobs.values():
        if job.state == "queued":
            assert job.needs_left == needs[job.id]
        if job.state in ("running", "succeeded"):
            assert needs[job.id] == 0, "it started before what it needs was done"


def shown(session: Session, root_id: str) -> Shown:
    """The revision of each job, the run's own included, and what is shown of it."""
    jobs = session.scalars(select(Job).where(Job.root_id == root_id))
    return {job.id: (job.revision, (job.state, job.failure_code, job.cancel_reason, job.attempt)) for job in jobs}


def assert_told(before: Shown, after: Shown) -> None:
    """Streams of events are sent by revision: what changes without one that grows is seen by nobody who looks on."""
    for job_id, (revision, what) in before.items():
        assert after[job_id][0] > revision or (revision, what) == after[job_id], (before[job_id], after[job_id])


@pytest.mark.parametrize("seed", range(24))
def test_a_run_stays_consistent_through_any_history(platform: Platform, seed: int) -> None:
    history = History(platform, seed)
    with platform.database.reading() as session:
        before = shown(session, history.root)
    for _ in range(60):
        history.step()
        with platform.database.reading() as session:
            assert_consistent(session, history.root)
            assert session.query(Job).count() == 1 + history.jobs, "what follows a success is forgotten"
            after = shown(session, history.root)
        assert_told(before, after)
        before = after
