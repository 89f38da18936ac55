"""Runs of several jobs: what waits, what follows, how a run ends, what a retry takes up; and any history of one."""

import random
from contextlib import nullcontext

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.jobs import completion
from services.runtime.jobs.attempt_lines import AttemptWords
from services.runtime.jobs.claims import Claim, claim, start_run
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.control import cancel, retry, set_mode, terminate
from services.runtime.jobs.errors import JobStateError, QueueDrainingError
from services.runtime.jobs.lease_sweep import lose_silent
from services.runtime.jobs.leases import renew
from services.runtime.jobs.queries import progress_of
from services.runtime.jobs.specs import TERMINAL, Attempt, JobSpec, Outcome
from services.runtime.orm import FigureRow, Job, JobAttempt, JobNeed
from services.runtime.platform import Platform
from testing.threads import at_once
from tests.services.runtime.jobs.steps import HANDLERS, T, a_job, a_run, act, an_owner, claimed, job, run_all, states

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


Shown = dict[str, tuple[int, tuple[object, ...]]]
FAILURE = Failure("odd", "as the dice fell")
MOST_JOBS, MOST_ATTEMPTS, STEPS = 30, 3, 90


class History:
    """Plays random steps on one run, or on a job of its own.

    It keeps the claims that were ever handed out and what sweepers ever saw, dead ones too: whoever is slow, or lost an
    answer, acts on what is no longer so.
    """

    def __init__(self, platform: Platform, seed: int) -> None:
        self.dice, self.platform, owner = random.Random(seed), platform, an_owner(platform)
        self.jobs = self.dice.choice((0, 1, 2, 6, 6))
        specs = [JobSpec("ingest.ok", key=str(n), needs=self._earlier(n)) for n in range(self.jobs)]
        self.root = a_run(platform, owner, *specs) if specs else a_job(platform, owner)
        self.claims, self.seen = list[Claim](), list[Job]()

    def _earlier(self, number: int) -> tuple[str, ...]:
        return tuple(str(other) for other in range(number) if self.dice.random() < 0.4)

    def step(self) -> None:
        if job(self.platform, self.root).state in ("failed", "cancelled") and self.dice.random() < 0.5:
            act(self.platform, retry, self.root, MOST_ATTEMPTS)
            return
        often, seldom = (self.take, self.beat, self.look), (self.succeed, self.fail, self.lose, self.sweep, self.steer)
        self.dice.choice((*often, *often, *seldom))()

    def one_of(self, known: list[T]) -> T:
        """Mostly a late one, of which more are still true."""
        return self.dice.choice(known[-2:] if self.dice.random() < 0.7 else known)

    def take(self) -> None:
        if taken := act(self.platform, claim, "ingest"):
            self.claims.append(taken)
        if self.claims:
            act(self.platform, start_run, self.one_of(self.claims))

    def succeed(self) -> None:
        is_short = job_count(self.platform) < MOST_JOBS
        grows = self.jobs and is_short and self.dice.random() < 0.4
        then = (JobSpec("ingest.ok", key="x"), JobSpec("ingest.ok", needs=("x",))) if grows else ()
        if self.claims and self._end(self.one_of(self.claims), then):
            self.jobs += len(then)

    def fail(self) -> None:
        if self.claims and self.dice.random() < 0.3:
            act(self.platform, completion.fail, self.one_of(self.claims), FAILURE)

    def lose(self) -> None:
        if self.claims:
            act(self.platform, completion.lose, self.one_of(self.claims), FAILURE)

    def beat(self) -> None:
        """Whoever holds the job is heard, and nobody else."""
        if not self.claims:
            return
        taken = self.one_of(self.claims)
        before = job(self.platform, taken.job_id)
        is_held = (before.state, before.attempt) == ("running", taken.attempt)
        (answer,) = renew(self.platform.database, [AttemptWords(taken.job_id, taken.attempt)])
        assert (answer.is_held, answer.is_written) == (is_held, is_held)
        assert job(self.platform, taken.job_id).heartbeats == before.heartbeats + is_held

    def look(self) -> None:
        """What a sweeper sees, and may take away later, if it was silent since."""
        with self.platform.database.reading() as session:
            self.seen += session.scalars(select(Job).where(Job.state == "running", Job.queue != "")).all()

    def sweep(self) -> None:
        if self.seen:
            seen = self.one_of(self.seen)
            now = job(self.platform, seen.id)
            is_silent = (now.state, now.attempt, now.heartbeats) == ("running", seen.attempt, seen.heartbeats)
            assert act(self.platform, lose_silent, seen, 20.0) == is_silent

    def steer(self) -> None:
        name, state = self.dice.choice((cancel, terminate, retry)), job(self.platform, self.root).state
        is_refused = state not in ("failed", "cancelled") if name is retry else state in TERMINAL
        with pytest.raises(JobStateError) if is_refused else nullcontext():
            act(self.platform, name, self.root, MOST_ATTEMPTS if name is retry else "as the dice fell")  # type: ignore[arg-type]

    def finish(self) -> None:
        """Nothing more goes wrong: whoever holds a job ends it, and what is ready is taken."""
        while True:
            for taken in self.claims:
                if job(self.platform, self.root).cancel_reason:
                    act(self.platform, completion.cancelled, taken)
                else:
                    self._end(taken)
            self.claims.clear()
            self.take()
            if not self.claims:
                return

    def _end(self, taken: Claim, then: tuple[JobSpec, ...] = ()) -> bool:
        def count_commit(session: Session) -> None:
            row = session.get(FigureRow, taken.job_id) or FigureRow(name=taken.job_id, value=0, measured_ns=1)
            row.value += 1
            session.add(row)

        return act(self.platform, completion.succeed, taken, Outcome(then=then, commit=count_commit), MOST_ATTEMPTS)


def job_count(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.query(Job).count()


def assert_consistent(session: Session, root_id: str) -> None:
    run = session.get_one(Job, root_id)
    others = {one.id: one for one in session.scalars(select(Job).where(Job.root_id == root_id, Job.id != root_id))}
    jobs = others or {run.id: run}
    states = {one.state for one in jobs.values()}
    assert (run.state in TERMINAL) == (not states & {"queued", "running"}), (run.state, states)
    if run.state == "succeeded":
        assert states == {"succeeded"}
    if run.state == "failed":
        assert run.failure_code
    if run.cancel_reason:
        assert "queued" not in states, "it was asked to stop, and more of it will start"
    open_attempts = session.scalars(select(JobAttempt.job_id).where(JobAttempt.outcome == "")).all()
    assert sorted(open_attempts) == sorted(one.id for one in jobs.values() if one.state == "running")
    commits = {row.name: row.value for row in session.scalars(select(FigureRow))}
    assert commits == {one.id: 1 for one in jobs.values() if one.state == "succeeded"}, "a success is lost, or twice"
    needs: dict[str, int] = dict.fromkeys(jobs, 0)
    for need in session.scalars(select(JobNeed)):
        needs[need.job_id] += jobs[need.needed_id].state != "succeeded"
    for one in jobs.values():
        assert one.attempts_left >= 0
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
@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.release) for seed in range(4, 80))])
def test_a_run_stays_consistent_through_any_history_and_ends(platform: Platform, seed: int) -> None:
    """Catches alone a step of jobs that is sound by itself and not beside some other, in an order nobody thought of."""
    history = History(platform, seed)
    with platform.database.reading() as session:
        before = shown(session, history.root)
    for _ in range(STEPS):
        history.step()
        with platform.database.reading() as session:
            assert_consistent(session, history.root)
            assert session.query(Job).count() == 1 + history.jobs, "what follows a success is forgotten"
            after = shown(session, history.root)
        assert_told(before, after)
        before = after
    history.finish()
    assert job(platform, history.root).state in TERMINAL
    with platform.database.reading() as session:
        assert_consistent(session, history.root)
