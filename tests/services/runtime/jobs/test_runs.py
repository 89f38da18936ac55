"""Runs of several jobs: what waits, what follows, how a run ends, what a retry takes up."""

from threading import Barrier, Thread

import pytest

from services.runtime.jobs import completion
from services.runtime.jobs.claims import claim
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.control import cancel, retry, set_mode, terminate
from services.runtime.jobs.errors import QueueDrainingError
from services.runtime.jobs.queries import progress_of
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.orm import Job
from services.runtime.platform import Platform
from tests.services.runtime.jobs.steps import HANDLERS, a_run, an_owner, job, run_all, states

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


def test_a_stage_can_bring_the_jobs_that_follow_it(platform_on: Platform) -> None:
    def plan(_attempt: Attempt) -> Outcome:
        parts = tuple(JobSpec("labeler.ok", {"say": str(part)}, key=str(part)) for part in range(5))
        return Outcome(then=(*parts, JobSpec("ingest.ok", needs=tuple(part.key for part in parts))))

    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.plan"))
    assert run_all(platform_on, {**HANDLERS, "ingest.plan": plan}) == 7
    assert job(platform_on, root).state == "succeeded"
    assert states(platform_on, root) == {"succeeded": 7}


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
    platform_on: Platform, queues: tuple[str, ...], expected: list[str]
) -> None:
    order: list[str] = []

    def note(attempt: Attempt) -> Outcome:
        order.append(str(attempt.arguments["say"]))
        return Outcome()

    table = {"ingest.plan": beside, "labeler.list": listed, "labeler.ok": note, "eval.ok": note}
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.plan"))
    run_all(platform_on, table, queues=queues)
    assert order == expected
    assert job(platform_on, root).state == "succeeded"


def test_a_retry_waits_anew_for_the_job_beside_that_failed(platform_on: Platform) -> None:
    def refused(attempt: Attempt) -> Outcome:
        return HANDLERS["ingest.refuse"](attempt)

    table = {**HANDLERS, "ingest.plan": beside, "labeler.list": listed, "eval.ok": refused}
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.plan"))
    run_all(platform_on, table, queues=("ingest", "labeler", "eval"))
    assert job(platform_on, root).state == "failed"
    with platform_on.database.transaction() as session:
        retry(session, root, 3)
    run_all(platform_on, {**table, "eval.ok": HANDLERS["labeler.ok"]}, queues=("labeler", "eval"))
    assert job(platform_on, root).state == "succeeded"
    assert states(platform_on, root) == {"succeeded": 5}


def test_a_job_that_would_wait_for_a_kind_its_run_never_had_is_a_mistake(platform_on: Platform) -> None:
    with pytest.raises(ValueError, match=r"has no job 'eval\.ok' to wait for"):
        a_run(platform_on, an_owner(platform_on), JobSpec("labeler.ok", after=("eval.ok",)))


def test_a_failure_ends_the_run_with_its_reason_and_nothing_more_of_it_starts(platform_on: Platform) -> None:
    owner = an_owner(platform_on)
    root = a_run(
        platform_on, owner, JobSpec("ingest.refuse", key="read"), JobSpec("labeler.ok", needs=("read",)),
    )  # fmt: skip
    assert run_all(platform_on) == 1
    failed = job(platform_on, root)
    assert (failed.state, failed.failure_code) == ("failed", "unreadable")
    assert states(platform_on, root) == {"failed": 1, "cancelled": 1}


def test_a_run_that_failed_waits_for_what_still_runs_of_it(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.refuse"), JobSpec("labeler.ok"))
    with platform_on.database.transaction() as session:
        busy = claim(session, "labeler")
    run_all(platform_on, queues=("ingest",))
    assert job(platform_on, root).state == "running"
    assert busy is not None
    with platform_on.database.transaction() as session:
        assert completion.cancelled(session, busy)
    assert job(platform_on, root).state == "failed"


def test_the_two_last_jobs_of_a_run_ending_at_once_end_it(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), *(JobSpec("ingest.ok") for _ in range(8)))
    claims = []
    for _ in range(8):
        with platform_on.database.transaction() as session:
            claims.append(claim(session, "ingest"))
    together = Barrier(len(claims))

    def end(index: int) -> None:
        together.wait()
        with platform_on.database.transaction() as session:
            completion.succeed(session, claims[index], Outcome(), 3)  # type: ignore[arg-type]

    threads = [Thread(target=end, args=(index,)) for index in range(len(claims))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert job(platform_on, root).state == "succeeded"


def test_cancelling_a_run_cancels_what_is_queued_and_asks_the_rest(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.ok"), JobSpec("labeler.ok"))
    with platform_on.database.transaction() as session:
        busy = claim(session, "labeler")
    assert busy is not None
    with platform_on.database.transaction() as session:
        cancel(session, root, "wrong calibration")
    assert states(platform_on, root) == {"running": 1, "cancelled": 1}
    with platform_on.database.transaction() as session:
        assert completion.succeed(session, busy, Outcome(then=(JobSpec("labeler.ok"),)), 3)
    assert states(platform_on, root) == {"succeeded": 1, "cancelled": 2}, "what follows is there and does not start"
    assert run_all(platform_on) == 0
    assert job(platform_on, root).state == "cancelled"


def test_terminating_a_run_takes_its_jobs_away_at_once(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.ok"), JobSpec("labeler.ok"))
    with platform_on.database.transaction() as session:
        busy = claim(session, "labeler")
    assert busy is not None
    with platform_on.database.transaction() as session:
        terminate(session, root, "it eats the machine")
    assert job(platform_on, root).state == "cancelled"
    assert states(platform_on, root) == {"cancelled": 2}
    with platform_on.database.transaction() as session:
        assert not completion.succeed(session, busy, Outcome(), 3)


@pytest.mark.parametrize("then", [(), (JobSpec("labeler.ok", key="a"), JobSpec("labeler.ok", needs=("a",)))])
def test_a_run_cancelled_while_its_last_job_succeeds_is_taken_up_by_a_retry(
    platform_on: Platform, then: tuple[JobSpec, ...]
) -> None:
    """The job did not look whether it was to stop; what was to follow it must not be lost with the cancelling."""
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.ok"))
    with platform_on.database.transaction() as session:
        taken = claim(session, "ingest")
    assert taken is not None
    with platform_on.database.transaction() as session:
        cancel(session, root, "the wrong profile")
    with platform_on.database.transaction() as session:
        assert completion.succeed(session, taken, Outcome(then=then), 3)
    assert job(platform_on, root).state == "cancelled"
    assert run_all(platform_on) == 0
    with platform_on.database.transaction() as session:
        retry(session, root, 3)
    assert run_all(platform_on) == len(then)
    assert job(platform_on, root).state == "succeeded"
    assert states(platform_on, root) == {"succeeded": 1 + len(then)}


def test_a_retry_takes_up_what_failed_and_leaves_what_was_done(platform_on: Platform) -> None:
    mended = False
    ran: list[str] = []

    def brittle(attempt: Attempt) -> Outcome:
        ran.append(attempt.job_id)
        return HANDLERS["ingest.ok" if mended else "ingest.refuse"](attempt)

    root = a_run(
        platform_on,
        an_owner(platform_on),
        JobSpec("ingest.ok", key="read"),
        JobSpec("labeler.brittle", key="fuse", needs=("read",)),
        JobSpec("labeler.ok", needs=("fuse",)),
    )
    handlers = {**HANDLERS, "labeler.brittle": brittle}
    run_all(platform_on, handlers)
    assert job(platform_on, root).state == "failed"
    mended = True
    with platform_on.database.transaction() as session:
        retry(session, root, 3)
    assert run_all(platform_on, handlers) == 2
    done = job(platform_on, root)
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
    with platform.database.transaction() as session:
        set_mode(session, "labeler", "draining")
    with pytest.raises(QueueDrainingError, match="'labeler' is draining"):
        a_run(platform, owner, *ORDER)
    run_all(platform)
    assert job(platform, root).state == "succeeded"


def test_a_run_of_no_jobs_is_refused(platform: Platform) -> None:
    with pytest.raises(ValueError, match="never end"):
        a_run(platform, an_owner(platform))


def test_a_failure_of_an_attempt_with_tries_left_is_not_the_runs(platform_on: Platform) -> None:
    root = a_run(platform_on, an_owner(platform_on), JobSpec("ingest.ok"))
    with platform_on.database.transaction() as session:
        lost = claim(session, "ingest")
    assert lost is not None
    with platform_on.database.transaction() as session:
        assert completion.lose(session, lost, Failure("worker_lost", "silent"))
    run_all(platform_on)
    assert job(platform_on, root).state == "succeeded"
