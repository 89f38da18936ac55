"""One attempt: how it ends, what it says while it works, what stops it."""

from dataclasses import replace
from time import monotonic, process_time
from time import sleep as wait

import pytest
from sqlalchemy import select

from services.runtime.database.transactions import Database
from services.runtime.jobs import completion
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.control import cancel
from services.runtime.jobs.execution import Reporter
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.orm import JobAttempt, JobLine, User
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.factory import open_store
from services.runtime.store.s3 import store_unavailable
from tests.services.runtime.jobs.steps import a_job, a_run, act, an_owner, claimed, job, ran, run_all, states


def attempts_of(platform: Platform, job_id: str) -> list[JobAttempt]:
    with platform.database.reading() as session:
        return list(session.scalars(select(JobAttempt).where(JobAttempt.job_id == job_id).order_by(JobAttempt.number)))


def lines_of(platform: Platform, job_id: str) -> list[JobLine]:
    with platform.database.reading() as session:
        ordered = select(JobLine).where(JobLine.job_id == job_id).order_by(JobLine.attempt, JobLine.number)
        return list(session.scalars(ordered))


def test_a_job_that_returns_has_succeeded_and_keeps_its_result(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform), say="hello")
    assert run_all(platform) == 1
    done = job(platform, job_id)
    assert (done.state, done.result, done.attempt) == ("succeeded", {"said": "hello"}, 1)
    assert done.finished_ns is not None
    assert [attempt.outcome for attempt in attempts_of(platform, job_id)] == ["succeeded"]


def test_an_attempt_that_has_succeeded_is_not_taken_for_lost_by_its_own_heart(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wake-up is sent after the commit: until it has been, the job is no longer held and the heart still beats."""
    ended: list[str] = []
    monkeypatch.setattr(Reporter, "_end_process", lambda reporter, reason: ended.append(reason))
    limits = replace(settings.jobs, progress_s=0.01, heartbeat_s=0.01)
    slow_wake_up = Database(settings, lambda queue, times: wait(0.3))
    platform = Platform(settings.model_copy(update={"jobs": limits}), slow_wake_up, open_store(settings))
    run_id = a_run(
        platform, an_owner(platform), JobSpec("ingest.ok", key="first"), JobSpec("labeler.ok", needs=("first",))
    )
    assert run_all(platform) == 2
    platform.database.close()
    assert (states(platform, run_id), ended) == ({"succeeded": 2}, [])


def test_a_refused_input_fails_at_once_with_its_code_and_sentence(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform), "ingest.refuse")
    assert run_all(platform) == 1
    failed = job(platform, job_id)
    assert (failed.state, failed.failure_code) == ("failed", "unreadable")
    assert failed.failure == "the bag is cut at byte 7"


def test_a_fault_of_the_machine_is_tried_again_until_the_attempts_are_used_up(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform), "ingest.stumble")
    assert run_all(platform) == 3
    failed = job(platform, job_id)
    assert (failed.state, failed.failure_code) == ("failed", "internal_error")
    assert "Input/output error" in failed.failure
    assert [attempt.outcome for attempt in attempts_of(platform, job_id)] == ["lost", "lost", "failed"]
    assert any("Traceback" in str(line.facts) for line in lines_of(platform, job_id))


def test_a_kind_no_worker_knows_fails_and_names_what_is_known(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform), "ingest.dream")
    run_all(platform)
    assert job(platform, job_id).failure_code == "unknown_kind"
    assert "ingest.ok" in job(platform, job_id).failure


def test_rows_and_success_are_one_transaction(platform: Platform) -> None:
    """A commit that fails leaves neither the rows nor the success."""
    owner = an_owner(platform)

    def half(_attempt: Attempt) -> Outcome:
        def commit(session: object) -> None:
            session.add(User(name="half", role="curator"))  # type: ignore[attr-defined]
            session.flush()  # type: ignore[attr-defined]
            raise OSError(28, "No space left on device")

        return Outcome(commit=commit)

    job_id = a_job(platform, owner, "ingest.half")
    run_all(platform, {"ingest.half": half})
    with platform.database.reading() as session:
        assert session.scalar(select(User.id).where(User.name == "half")) is None
    assert job(platform, job_id).state == "failed"


def test_log_lines_can_be_read_while_the_job_runs(platform: Platform) -> None:
    seen: list[str] = []

    def talk(attempt: Attempt) -> None:
        attempt.log("opened the bag", topics=14)
        deadline = 200
        while not seen and deadline:
            seen.extend(line.event for line in lines_of(platform, attempt.job_id))
            wait(0.02)
            deadline -= 1

    job_id = ran(platform, talk)
    assert seen == ["opened the bag"]
    assert lines_of(platform, job_id)[0].facts == {"topics": 14}


def test_lines_beyond_the_limit_are_counted_out_by_the_last_one(platform: Platform) -> None:
    limit = platform.settings.jobs.log_lines_per_attempt

    def chatter(attempt: Attempt) -> None:
        for number in range(limit + 10):
            attempt.log(f"line {number}")

    job_id = ran(platform, chatter)
    lines = lines_of(platform, job_id)
    assert len(lines) == limit
    assert f"more than {limit} lines" in lines[-1].event


def test_progress_is_written_a_few_times_however_often_it_is_said(platform: Platform) -> None:
    def count(attempt: Attempt) -> None:
        for done in range(20_000):
            attempt.progress("frames", done, 20_000)
        wait(platform.settings.jobs.progress_s * 2)

    job_id = ran(platform, count)
    told = job(platform, job_id)
    assert (told.stage, told.total) == ("frames", 20_000)
    assert told.done == 20_000
    assert told.revision < 20


def test_the_last_word_of_a_quick_job_is_kept(platform: Platform) -> None:
    def count(attempt: Attempt) -> None:
        attempt.progress("frames", 7, 8)

    job_id = ran(platform, count)
    told = job(platform, job_id)
    assert (told.stage, told.done, told.total) == ("frames", 8, 8)


def test_what_an_attempt_cost_is_kept_with_it(platform: Platform) -> None:
    def burn(_attempt: Attempt) -> None:
        begin = process_time()
        while process_time() - begin < 0.2:
            pass

    job_id = ran(platform, burn)
    (attempt,) = attempts_of(platform, job_id)
    assert attempt.cpu_s is not None
    assert attempt.cpu_s >= 0.2
    assert attempt.peak_bytes is not None


def test_a_store_that_is_away_is_waited_for_and_then_named(platform: Platform) -> None:
    tries: list[float] = []

    def copy(_attempt: Attempt) -> Outcome:
        tries.append(monotonic())
        raise store_unavailable("s3", "connection refused")

    job_id = a_job(platform, an_owner(platform), "ingest.copy")
    run_all(platform, {"ingest.copy": copy})
    failed = job(platform, job_id)
    assert (failed.state, failed.failure_code) == ("failed", "store_unavailable")
    rest_s = platform.settings.jobs.rest_s
    assert [
        after - before >= rest_s * factor for before, after, factor in zip(tries, tries[1:], (1, 2), strict=False)
    ] == [True] * 2


def test_a_job_asked_to_stop_ends_cancelled_at_its_next_word(platform: Platform) -> None:
    def work(attempt: Attempt) -> None:
        act(platform, cancel, attempt.root_id, "wrong bag")
        for step in range(500):
            attempt.progress("frames", step, 500)
            wait(0.02)

    job_id = ran(platform, work)
    stopped = job(platform, job_id)
    assert (stopped.state, stopped.cancel_reason) == ("cancelled", "wrong bag")
    assert [attempt.outcome for attempt in attempts_of(platform, job_id)] == ["cancelled"]


def test_an_attempt_that_lost_its_job_changes_nothing(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform))
    zombie = claimed(platform)
    assert act(platform, completion.lose, zombie, Failure("worker_lost", "silent"))
    heir = claimed(platform)
    assert heir.attempt == zombie.attempt + 1
    for end in (
        lambda session: completion.succeed(session, zombie, Outcome({"by": "zombie"}), 3),
        lambda session: completion.fail(session, zombie, Failure("late", "late")),
        lambda session: completion.cancelled(session, zombie),
        lambda session: completion.lose(session, zombie, Failure("late", "late")),
    ):
        with platform.database.transaction() as session:
            assert not end(session)
    assert job(platform, job_id).state == "running"
    assert act(platform, completion.succeed, heir, Outcome({"by": "heir"}), 3)
    assert job(platform, job_id).result == {"by": "heir"}
