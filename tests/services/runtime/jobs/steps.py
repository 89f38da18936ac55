"""What the tests of the jobs share: an owner, a queue run to its end, small handlers."""

from collections.abc import Callable, Mapping
from typing import Any, Concatenate, ParamSpec, TypeVar

from sqlalchemy.orm import Session

from services.runtime.jobs.claims import Claim, claim
from services.runtime.jobs.enqueue import enqueue, enqueue_run
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Context, Handlers, JobSpec, Outcome
from services.runtime.orm import Job, User
from services.runtime.platform import Platform
from stone.errors import StoneError

P = ParamSpec("P")
T = TypeVar("T")


class UnreadableError(StoneError):
    """A stand-in for a refusal of the input."""

    code = "unreadable"

    def __init__(self) -> None:
        super().__init__("the bag is cut at byte 7")


def succeed(attempt: Attempt) -> Outcome:
    return Outcome({"said": attempt.arguments.get("say", "done")})


def refuse(_attempt: Attempt) -> Outcome:
    raise UnreadableError


def stumble(_attempt: Attempt) -> Outcome:
    raise OSError(5, "Input/output error")


HANDLERS: Handlers = {
    "ingest.ok": succeed,
    "ingest.refuse": refuse,
    "ingest.stumble": stumble,
    "labeler.ok": succeed,
}


def an_owner(platform: Platform, name: str = "ada") -> str:
    with platform.database.transaction() as session:
        user = User(name=name, role="curator")
        session.add(user)
        session.flush()
        return user.id


def a_job(platform: Platform, owner: str, kind: str = "ingest.ok", priority: int = 0, **arguments: Any) -> str:
    with platform.database.transaction() as session:
        return enqueue(session, JobSpec(kind, arguments), Context(owner, priority=priority)).id


def a_run(platform: Platform, owner: str, *specs: JobSpec) -> str:
    with platform.database.transaction() as session:
        return enqueue_run(session, "sequence.process", specs, Context(owner)).id


def claimed(platform: Platform, queue: str = "ingest") -> Claim:
    """The next job, taken by somebody who says nothing more."""
    taken = act(platform, claim, queue)
    assert taken is not None
    return taken


def act(platform: Platform, what: Callable[Concatenate[Session, P], T], *said: P.args, **more: P.kwargs) -> T:
    """What is answered in a transaction of its own."""
    with platform.database.transaction() as session:
        return what(session, *said, **more)


def run_all(platform: Platform, handlers: Handlers = HANDLERS, queues: tuple[str, ...] = ("ingest", "labeler")) -> int:
    """Run jobs until no queue has a ready one; how many attempts that took."""
    attempts = 0
    while any(run_next(platform, queue, handlers) for queue in queues):
        attempts += 1
    return attempts


def ran(platform: Platform, work: Callable[[Attempt], object]) -> str:
    """The id of a job that has done this, in as many attempts as it took."""

    def do(attempt: Attempt) -> Outcome:
        work(attempt)
        return Outcome()

    job_id = a_job(platform, an_owner(platform), "ingest.work")
    run_all(platform, {"ingest.work": do})
    return job_id


def job(platform: Platform, job_id: str) -> Job:
    with platform.database.reading() as session:
        return session.get_one(Job, job_id)


def states(platform: Platform, root_id: str) -> Mapping[str, int]:
    """How many jobs of a run, the run's own row left out, are in each state."""
    with platform.database.reading() as session:
        found = [row.state for row in session.query(Job).where(Job.root_id == root_id, Job.id != root_id)]
    return {state: found.count(state) for state in set(found)}
