"""Runs of several jobs: what waits, what follows, how a run ends, what a retry takes up; and any history of one."""

import random
from collections.abc import Callable

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.jobs import completion
from services.runtime.jobs.claims import Claim, claim
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.control import cancel, retry, set_mode, terminate
from services.runtime.jobs.errors import JobStateError, QueueDrainingError
from services.runtime.jobs.queries import progress_of
from services.runtime.jobs.specs import TERMINAL, Attempt, JobSpec, Outcome
from services.runtime.orm import Job, JobNeed
from services.runtime.platform import Platform
from testing.threads import at_once
from tests.services.runtime.jobs.steps import HANDLERS, a_run, act, an_owner, claimed, job, run_all, states

ORDER = (
    JobSpec("ingest.ok", key="read"),
    JobSpec("labeler.ok", {"say": "a"}, key="a", needs=("read",)),
    JobSpec("labeler.ok", {"say": "b"}, key="b", needs=("read",)),
    JobSpec("labeler.ok", {"say": "join"}, needs=("a", "b")),
)


def test_a_job_starts_only_when_all_it_needs_has_succeeded(platform_on: Platform) -> None:
    order: list[str] = []

    def note(attempt: Attempt) -> Outcome:
        order.append(str(attempt.arguments.get("say", "read")))
        return Outcome()

    root = a_run(platform_on, an_owner(platform_on), *ORDER)
    assert job(platform_on, root).state == "queued"
    run_all(platform_on, {"ingest.ok": note, "labeler.ok": note}, queues=("labeler", "ingest"))
    assert order == ["read", "a", "b", "join"]
    assert job(platform_on, root).state == "succeeded"


def test_a_stage_can_bring_the_jobs_that_follow_it(platform: Platform) -> None:
    def plan(_attempt: Attempt) -> Outcome:
        parts = tuple(JobSpec("labeler.ok", {"say": str(part)}, key=str(part)) for part in range(5))
        return Outcome(then=(*parts, JobSpec("ingest.ok", needs=tuple(part.key for part in parts))))

    root = a_run(platform, an_owner(platform), JobSpec("ingest.plan"))
    assert run_all(platform, {**HANDLERS, "ingest.plan": plan}) == 7
    assert job(platform, root).state == "succeeded"
    assert states(platform, root) == {"succeeded": 7}


def beside(_attempt: Attempt) -> Outcome:
    """A job is done beside others, the last of which waits for it."""
    return Outcome(then=(JobSpec("eval.ok", {"say": "beside"}), JobSpec("labeler.list")))


def listed(_attempt: Attempt) -> Outcome:
    part, last = JobSpec("labeler.ok", {"say": "part"}, "part"), {"say": "last"}
    return Outcome(then=(part, JobSpec("labeler.ok", last, needs=("part",), after=("eval.ok",))))


@pytest.mark.parametrize(
    ("queues", "expected"),
    [
        (("ingest", "labeler", "eval"), ["part", "beside", "last"]),
        (("ingest", "eval", "labeler"), ["beside", "part", "last"]),
    ],
)
def test_a_job_waits_for_one_that_its_run_had_before_whether_that_is_done_or_not(
    platform: Platform, queues: tuple[str, ...], expected: list[str]
) -> None:
    order: list[str] = []

    def note(attempt: Attempt) -> Outcome:
        order.append(str(attempt.arguments["say"]))
        return Outcome()

    table = {"ingest.plan": beside, "labeler.list": listed, "labeler.ok": note, "eval.ok": note}
    root = a_run(platform, an_owner(platform), JobSpec("ingest.plan"))
    run_all(platform, table, queues=queues)
    assert order == expected
    assert job(platform, root).state == "succeeded"


def test_a_retry_waits_anew_for_the_job_beside_that_failed(platform: Platform) -> None:
    def refused(attempt: Attempt) -> Outcome:
        return HANDLERS["ingest.refuse"](attempt)

    table = {**HANDLERS, "ingest.plan": beside, "labeler.list": listed, "eval.ok": refused}
    root = a_run(platform, an_owner(platform), JobSpec("ingest.plan"))
    run_all(platform, table, queues=("ingest", "labeler", "eval"))
    assert job(platform, root).state == "failed"
    act(platform, retry, root, 3)
    run_all(platform, {**table, "eval.ok": HANDLERS["labeler.ok"]}, queues=("labeler", "eval"))
    assert job(platform, root).state == "succeeded"
    assert states(platform, root) == {"succeeded": 5}


def test_a_job_that_would_wait_for_a_kind_its_run_never_had_is_a_mistake(platform: Platform) -> None:
    with pytest.raises(ValueError, match=r"has no job 'eval\.ok' to wait for"):
        a_run(platform, an_owner(platform), JobSpec("labeler.ok", after=("eval.ok",)))


def test_a_failure_ends_the_run_with_its_reason_and_nothing_more_of_it_starts(platform: Platform) -> None:
    owner = an_owner(platform)
    root = a_run(
        platform, owner, JobSpec("ingest.refuse", key="read"), JobSpec("labeler.ok", needs=("read",)),
    )  # fmt: skip
    assert run_all(platform) == 1
    failed = job(platform, root)
    assert (failed.state, failed.failure_code) == ("failed", "unreadable")
    assert states(platform, root) == {"failed": 1, "cancelled": 1}


def test_a_run_that_failed_waits_for_what_still_runs_of_it(platform: Platform) -> None:
    root = a_run(platform, an_owner(platform), JobSpec("ingest.refuse"), JobSpec("labeler.ok"))
    with platform.database.transaction() as session:
        busy = claim(session, "labeler")
    run_all(platform, queues=("ingest",))
    assert job(platform, root).state == "running"
    assert busy is not None
    assert act(platform, completion.cancelled, busy)
    assert job(platform, root).state == "failed"


def test_the_two_last_jobs_of_a_run_ending_at_once_end_it(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), *(JobSpec("ingest.ok") for _ in range(8)))
    with platform_on.database.transaction() as session:
        claims = [claim(session, "ingest") for _ in range(8)]

    def end(index: int) -> None:
        with platform_on.database.transaction() as session:
            completion.succeed(session, claims[index], Outcome(), 3)  # type: ignore[arg-type]

    at_once(8, end)
    assert job(platform_on, root).state == "succeeded"


def test_cancelling_a_run_cancels_what_is_queued_and_asks_the_rest(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.ok"), JobSpec("labeler.ok"))
    busy = claimed(platform_on, "labeler")
    act(platform_on, cancel, root, "wrong calibration")
    assert states(platform_on, root) == {"running": 1, "cancelled": 1}
    assert act(platform_on, completion.succeed, busy, Outcome(then=(JobSpec("labeler.ok"),)), 3)
    assert states(platform_on, root) == {"succeeded": 1, "cancelled": 2}, "what follows is there and does not start"
    assert run_all(platform_on) == 0
    assert job(platform_on, root).state == "cancelled"


def test_terminating_a_run_takes_its_jobs_away_at_once(platform: Platform) -> None:
    root = a_run(platform, an_owner(platform), JobSpec("ingest.ok"), JobSpec("labeler.ok"))
    busy = claimed(platform, "labeler")
    act(platform, terminate, root, "it eats the machine")
    assert job(platform, root).state == "cancelled"
    assert states(platform, root) == {"cancelled": 2}
    assert not act(platform, completion.succeed, busy, Outcome(), 3)


@pytest.mark.parametrize("then", [(), (JobSpec("labeler.ok", key="a"), JobSpec("labeler.ok", needs=("a",)))])
def test_a_run_cancelled_while_its_last_job_succeeds_is_taken_up_by_a_retry(
    platform: Platform, then: tuple[JobSpec, ...]
) -> None:
    """The job did not look whether it was to stop; what was to follow it must not be lost with the cancelling."""
    root = a_run(platform, an_owner(platform), JobSpec("ingest.ok"))
    taken = claimed(platform)
    act(platform, cancel, root, "the wrong profile")
    assert act(platform, completion.succeed, taken, Outcome(then=then), 3)
    assert job(platform, root).state == "cancelled"
    assert run_all(platform) == 0
    act(platform, retry, root, 3)
    assert run_all(platform) == len(then)
    assert job(platform, root).state == "succeeded"
    assert states(platform, root) == {"succeeded": 1 + len(then)}


def test_a_retry_takes_up_what_failed_and_leaves_what_was_done(platform: Platform) -> None:
    mended = False
    ran: list[str] = []

    def brittle(attempt: Attempt) -> Outcome:
        ran.append(attempt.job_id)
        return HANDLERS["ingest.ok" if mended else "ingest.refuse"](attempt)

    root = a_run(
        platform,
        an_owner(platform),
        JobSpec("ingest.ok", key="read"),
        JobSpec("labeler.brittle", key="fuse", needs=("read",)),
        JobSpec("labeler.ok", needs=("fuse",)),
    )
    handlers = {**HANDLERS, "labeler.brittle": brittle}
    run_all(platform, handlers)
    assert job(platform, root).state == "failed"
    mended = True
    act(platform, retry, root, 3)
    assert run_all(platform, handlers) == 2
    done = job(platform, root)
    assert (done.state, done.failure_code) == ("succeeded", "")
    assert len(ran) == 2


def test_the_progress_of_a_run_counts_its_jobs_by_stage(platform: Platform) -> None:
    root = a_run(platform, an_owner(platform), *ORDER)
    run_all(platform, queues=("ingest",))
    with platform.database.reading() as session:
        progress = progress_of(session, session.get_one(Job, root))
    assert (progress.done, progress.total) == (1, 4)
    assert [(stage.kind, stage.done, stage.total) for stage in progress.stages] == [
        ("ingest.ok", 1, 1),
        ("labeler.ok", 0, 3),
    ]


def test_a_draining_queue_takes_nothing_new_and_finishes_what_it_has(platform: Platform) -> None:
    owner = an_owner(platform)
    root = a_run(platform, owner, *ORDER)
    act(platform, set_mode, "labeler", "draining")
    with pytest.raises(QueueDrainingError, match="labeler"):
        a_run(platform, owner, *ORDER)
    run_all(platform)
    assert job(platform, root).state == "succeeded"


def test_a_run_of_no_jobs_is_refused(platform: Platform) -> None:
    with pytest.raises(ValueError, match="never end"):
        a_run(platform, an_owner(platform))


def test_a_failure_of_an_attempt_with_tries_left_is_not_the_runs(platform: Platform) -> None:
    root = a_run(platform, an_owner(platform), JobSpec("ingest.ok"))
    lost = claimed(platform)
    assert act(platform, completion.lose, lost, Failure("worker_lost", "silent"))
    run_all(platform)
    assert job(platform, root).state == "succeeded"


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
    jobs = {one.id: one for one in session.scalars(select(Job).where(Job.root_id == root_id, Job.id != root_id))}
    states = {one.state for one in jobs.values()}
    is_over = not states & {"queued", "running"}
    assert (run.state in TERMINAL) == is_over, (run.state, states)
    if run.state == "succeeded":
        assert states == {"succeeded"}
    if run.state == "failed":
        assert run.failure_code
    needs: dict[str, int] = dict.fromkeys(jobs, 0)
    for need in session.scalars(select(JobNeed)):
        needs[need.job_id] += jobs[need.needed_id].state != "succeeded"
    for one in jobs.values():
        if one.state == "queued":
            assert one.needs_left == needs[one.id]
        if one.state in ("running", "succeeded"):
            assert needs[one.id] == 0, "it started before what it needs was done"


def shown(session: Session, root_id: str) -> Shown:
    """The revision of each one, the run's own included, and what is shown of it."""
    jobs = session.scalars(select(Job).where(Job.root_id == root_id))
    return {one.id: (one.revision, (one.state, one.failure_code, one.cancel_reason, one.attempt)) for one in jobs}


def assert_told(before: Shown, after: Shown) -> None:
    """Streams of events are sent by revision: what changes without one that grows is seen by nobody who looks on."""
    for job_id, (revision, what) in before.items():
        assert after[job_id][0] > revision or (revision, what) == after[job_id], (before[job_id], after[job_id])


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(12))
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
