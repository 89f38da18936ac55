"""What a platform left running when it ended is taken up at its next start, at once."""

import pytest
from sqlalchemy import select

from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import cancel
from services.runtime.jobs.interruption import CRASHED, STOPPED, give_back_running
from services.runtime.jobs.specs import JobSpec
from services.runtime.orm import JobAttempt
from services.runtime.platform import Platform
from tests.services.runtime.jobs.steps import a_job, a_run, an_owner, job, run_all


def begin(platform: Platform) -> None:
    """Start an attempt that will say nothing more."""
    with platform.database.transaction() as session:
        assert claim(session, "ingest") is not None


def test_an_orderly_stop_costs_no_attempt_however_often(platform_on: Platform) -> None:
    job_id = a_job(platform_on, an_owner(platform_on))
    for _ in range(5):
        begin(platform_on)
        assert give_back_running(platform_on, STOPPED, is_counted=False) == 1
        assert (job(platform_on, job_id).state, job(platform_on, job_id).attempts_left) == ("queued", 3)
    run_all(platform_on)
    assert job(platform_on, job_id).state == "succeeded"


def test_a_crash_counts_and_the_third_is_the_last(platform_on: Platform) -> None:
    job_id = a_job(platform_on, an_owner(platform_on))
    for left in (2, 1):
        begin(platform_on)
        give_back_running(platform_on, CRASHED, is_counted=True)
        assert (job(platform_on, job_id).state, job(platform_on, job_id).attempts_left) == ("queued", left)
    begin(platform_on)
    give_back_running(platform_on, CRASHED, is_counted=True)
    assert (job(platform_on, job_id).state, job(platform_on, job_id).failure_code) == ("failed", "worker_lost")


@pytest.mark.parametrize("is_counted", [False, True])
def test_a_job_that_was_asked_to_stop_is_cancelled_not_begun_again(platform: Platform, is_counted: bool) -> None:
    run_id = a_run(platform, an_owner(platform), JobSpec("ingest.ok"))
    begin(platform)
    with platform.database.transaction() as session:
        cancel(session, run_id, "enough")
    give_back_running(platform, CRASHED if is_counted else STOPPED, is_counted=is_counted)
    assert job(platform, run_id).state == "cancelled"


def test_the_attempt_says_why_it_ended_and_a_wake_up_is_sent(platform: Platform, bells: list[tuple[str, int]]) -> None:
    job_id = a_job(platform, an_owner(platform))
    begin(platform)
    bells.clear()
    give_back_running(platform, STOPPED, is_counted=False)
    assert bells == [("ingest", 1)]
    with platform.database.reading() as session:
        (attempt,) = session.scalars(select(JobAttempt).where(JobAttempt.job_id == job_id))
    assert (attempt.outcome, attempt.failure_code) == ("lost", "platform_stopped")


def test_nothing_running_is_nothing_to_do(platform: Platform) -> None:
    job_id = a_job(platform, an_owner(platform))
    assert give_back_running(platform, CRASHED, is_counted=True) == 0
    assert job(platform, job_id).attempts_left == 3
