"""The heartbeat of a job that lives: nothing that befalls the database, or is to be written, ends it."""

from collections.abc import Callable
from dataclasses import replace
from time import monotonic
from time import sleep as wait

import pytest
from sqlalchemy import select
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.orm import Session

from services.runtime.jobs.attempt_lines import AttemptLine, AttemptWords, progress_now
from services.runtime.jobs.claims import Claim, claim
from services.runtime.jobs.completion import Failure, lose
from services.runtime.jobs.control import cancel
from services.runtime.jobs.execution import Reporter
from services.runtime.jobs.leases import LeaseAnswer, renew
from services.runtime.jobs.specs import Attempt, JobSpec
from services.runtime.orm import Job, JobLine
from services.runtime.platform import Platform
from tests.services.runtime.jobs.outages import GONE, Away, LostAnswers, quick
from tests.services.runtime.jobs.steps import a_job, a_run, act, an_owner, claimed, job, ran

PATIENCE_S = 120.0


def until(is_so: Callable[[], bool]) -> bool:
    """Whether it came to be so within minutes."""
    end_s = monotonic() + PATIENCE_S
    while not (is_here := is_so()) and monotonic() < end_s:
        wait(0.01)
    return is_here


def goes_on_beating(platform: Platform, job_id: str, beats: int = 3) -> bool:
    begin = job(platform, job_id).heartbeats
    return until(lambda: job(platform, job_id).heartbeats >= begin + beats)


def events_of(platform: Platform, job_id: str) -> list[str]:
    with platform.database.reading() as session:
        lines = select(JobLine.event).where(JobLine.job_id == job_id).order_by(JobLine.attempt, JobLine.number)
        return list(session.scalars(lines))


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Why reporters would have ended this process."""
    reasons: list[str] = []

    def end(reporter: Reporter, reason: str) -> None:
        reasons.append(reason)
        reporter._leaving.set()

    monkeypatch.setattr(Reporter, "_end_process", end)
    return reasons


@pytest.mark.parametrize("commits", [1, 2], ids=["of the lines", "of the next heartbeat"])
def test_a_commit_whose_answer_is_lost_silences_no_heartbeat_and_doubles_no_line(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch, ended: list[str], commits: int
) -> None:
    platform, lost = quick(platform_on), LostAnswers(platform_on, monkeypatch)
    beats: list[bool] = []

    def talk(attempt: Attempt) -> None:
        goes_on_beating(platform, attempt.job_id)
        attempt.log("opened the bag")
        lost.after(commits)
        until(lambda: not lost.is_armed)
        attempt.log("read the bag")
        beats.append(goes_on_beating(platform, attempt.job_id))

    job_id = ran(platform, talk)
    assert (beats, ended) == ([True], [])
    assert events_of(platform, job_id) == ["opened the bag", "read the bag"]
    assert (job(platform, job_id).state, job(platform, job_id).attempt) == ("succeeded", 1)


@pytest.mark.parametrize(
    "error", [GONE, PoolTimeoutError("no connection in 30 s"), OSError(104, "reset"), ValueError("a bug of the driver")]
)
def test_no_error_of_the_database_ends_the_heartbeat(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, ended: list[str], error: Exception
) -> None:
    platform, away = quick(platform), Away(monkeypatch)
    beats: list[bool] = []

    def work(attempt: Attempt) -> None:
        goes_on_beating(platform, attempt.job_id)
        away.error = error
        attempt.progress("frames", 3, 8)
        attempt.log("said in the outage")
        until(lambda: away.refused >= 3)
        away.error = None
        beats.append(goes_on_beating(platform, attempt.job_id))

    job_id = ran(platform, work)
    assert (beats, ended, job(platform, job_id).state) == ([True], [], "succeeded")
    assert events_of(platform, job_id) == ["said in the outage"]


def test_a_time_limit_that_passes_during_an_outage_is_enforced_after_it(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, ended: list[str]
) -> None:
    platform, away = quick(platform, time_limit_s=0.2), Away(monkeypatch)

    def hang(attempt: Attempt) -> None:
        away.error = GONE
        until(lambda: away.refused >= 40)
        away.error = None
        until(lambda: bool(ended))

    job_id = ran(platform, hang)
    assert ended == ["time limit"]
    assert (job(platform, job_id).state, job(platform, job_id).failure_code) == ("failed", "time_limit")


def test_an_attempt_hears_after_an_outage_that_it_is_to_stop(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, ended: list[str]
) -> None:
    platform, away = quick(platform), Away(monkeypatch)

    def work(attempt: Attempt) -> None:
        act(platform, cancel, attempt.root_id, "wrong bag")
        away.error = GONE
        until(lambda: away.refused >= 3)
        away.error = None
        end_s = monotonic() + PATIENCE_S
        while monotonic() < end_s:
            attempt.progress("frames", 1, 2)
            wait(0.01)

    job_id = ran(platform, work)
    assert (job(platform, job_id).state, ended) == ("cancelled", [])


@pytest.mark.parametrize(
    ("stage", "count"), [("frames", 10**30), ("frames", 2**40), ("s" * 100, 1), ("a\x00b", 1), ("a\ud800b", 1)]
)
def test_progress_that_no_column_takes_silences_no_heartbeat(
    platform_on: Platform, ended: list[str], stage: str, count: int
) -> None:
    """A sandboxed child says what it likes, as often as it likes."""
    platform = quick(platform_on)
    beats: list[bool] = []

    def babble(attempt: Attempt) -> None:
        begin = job(platform, attempt.job_id).heartbeats

        def has_beaten() -> bool:
            attempt.progress(stage, count, count)
            return job(platform, attempt.job_id).heartbeats >= begin + 3

        beats.append(until(has_beaten))

    job_id = ran(platform, babble)
    assert (beats, ended, job(platform, job_id).state) == ([True], [], "succeeded")


def test_a_row_that_somebody_else_holds_locked_delays_no_heartbeat_of_the_others(
    on_postgres: Platform,
) -> None:
    platform = on_postgres
    owner = an_owner(platform)
    ids = [a_job(platform, owner, "ingest.work") for _ in range(2)]
    with platform.database.transaction() as session:
        words = [AttemptWords(one.job_id, one.attempt, progress_now("frames", 3, 8)) for one in claims(session, 2)]
    with platform.database.transaction() as session:
        session.get_one(Job, words[0].job_id, with_for_update=True)
        answers = renew(platform.database, words)
    assert answers == [LeaseAnswer(True, is_written=False), LeaseAnswer(True)]
    assert [(job(platform, one).heartbeats, job(platform, one).done) for one in ids] == [(0, 0), (1, 3)]


def test_many_attempts_are_renewed_at_once_and_each_is_answered_for_itself(platform_on: Platform) -> None:
    """One goes on, one is to stop, one was given to somebody else, one says what no column takes."""
    owner = an_owner(platform_on)
    ids = [a_job(platform_on, owner, "ingest.work") for _ in range(4)]
    with platform_on.database.transaction() as session:
        fine, asked, lost, odd = claims(session, 4)
        cancel(session, asked.job_id, "wrong bag")
        lose(session, lost, Failure("worker_lost", "silent"))
    line = AttemptLine(0, "info", "opened", {}, 1)
    unkept = replace(line, event="a\ud800b")
    heir = claimed(platform_on)
    assert (heir.job_id, heir.attempt) == (lost.job_id, 2)
    words = [
        AttemptWords(fine.job_id, 1, progress_now("frames", 3, 8), (line,)),
        AttemptWords(asked.job_id, 1),
        AttemptWords(lost.job_id, 1, progress_now("late", 1, 1), (line,)),
        AttemptWords(heir.job_id, 2, progress_now("early", 2, 9), (line,)),
        AttemptWords(odd.job_id, 1, progress_now("s" * 100, 1, 2), (line, replace(unkept, number=1))),
    ]
    held, told, gone, new, strange = renew(platform_on.database, words)
    assert (held, told.cancel_reason, gone.is_held, new.is_held, strange.is_held) == (
        LeaseAnswer(True), "wrong bag", False, True, True,
    )  # fmt: skip
    assert [job(platform_on, one).heartbeats for one in ids] == [1] * 4
    assert [job(platform_on, one).stage for one in ids] == ["frames", "", "early", ""]
    assert events_of(platform_on, fine.job_id) == ["opened"]
    assert events_of(platform_on, lost.job_id) == ["opened", "opened"], "of both attempts"
    assert "cannot be stored" in events_of(platform_on, odd.job_id)[1]


def test_an_attempt_hears_that_its_own_run_is_to_stop_and_no_other(platform: Platform) -> None:
    owner = an_owner(platform)
    runs = [a_run(platform, owner, JobSpec("ingest.ok"), JobSpec("ingest.ok")) for _ in range(3)]
    with platform.database.transaction() as session:
        taken = claims(session, 6)
        cancel(session, runs[1], "wrong bag")
    answers = renew(platform.database, [AttemptWords(one.job_id, one.attempt) for one in taken])
    told = {one.root_id: answer.cancel_reason for one, answer in zip(taken, answers, strict=True)}
    assert told == {runs[0]: "", runs[1]: "wrong bag", runs[2]: ""}


def claims(session: Session, count: int) -> list[Claim]:
    taken = [claim(session, "ingest") for _ in range(count)]
    return [one for one in taken if one is not None]


ODD: dict[str, dict[str, object]] = {
    "an object": {"x": object()},
    "a lone surrogate": {"topic": "a\ud800b"},
    "no number": {"x": float("nan")},
    "a null": {"topic": "a\x00b"},
}


@pytest.mark.parametrize("facts", ODD.values(), ids=ODD)
def test_a_line_that_cannot_be_kept_takes_neither_the_heartbeat_nor_the_other_lines_with_it(
    platform_on: Platform, ended: list[str], facts: dict[str, object]
) -> None:
    platform = quick(platform_on)
    beats: list[bool] = []

    def talk(attempt: Attempt) -> None:
        attempt.log("before")
        attempt.log("topic \x00 \ud800", **facts)
        attempt.log("after")
        beats.append(goes_on_beating(platform, attempt.job_id))

    job_id = ran(platform, talk)
    assert (beats, ended, job(platform, job_id).state) == ([True], [], "succeeded")
    first, odd, last = events_of(platform, job_id)
    assert (first, last) == ("before", "after")
    assert "cannot be stored" in odd
