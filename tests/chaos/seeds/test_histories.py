"""Seeded histories of jobs detect planted faults, and detect no fault in the unchanged platform."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from sqlalchemy import insert
from sqlalchemy.orm import Session

from chaos.seeds.histories import History, play
from services.runtime.jobs import completion, control, execution, leases
from services.runtime.jobs.attempt_lines import AttemptWords
from services.runtime.jobs.claims import Claim
from services.runtime.jobs.specs import JobSpec, Outcome
from services.runtime.orm import Job, JobLine

PAST = {14: "a job brought others `after` its own kind: its success was counted off twice, and one began too early"}
"""Seeds that detected a fault of the platform, with the fault. A seed gives another history if the draws change, so the
tests below also plant each fault."""
FRESH = range(3000, 3006)
MOST_SEEDS = 60
"""Each fault below is detected within this number of seeds; a tenth of them is enough."""


@pytest.mark.parametrize("seed", [*PAST, *FRESH])
def test_a_history_loses_and_doubles_nothing_and_ends(seed: int) -> None:
    assert play(seed).violation == ""


def test_a_seed_plays_the_same_history_again() -> None:
    assert play(FRESH[0]) == play(FRESH[0])


def found_from(first: int) -> History:
    """Return the first history from this seed on that violates a rule, at its end or on the way."""
    played = (play(seed) for seed in range(first, first + MOST_SEEDS))
    return next(history for history in played if history.violation)


def test_lines_that_are_inserted_again_after_a_lost_answer_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault of 24 November 2026: a live job's own lines made every heartbeat of it fail."""

    def insert_again(session: Session, words: Sequence[AttemptWords]) -> None:
        lines = [(one, line) for one in words for line in one.lines]
        for one, line in lines:
            said = {"number": line.number, "level": line.level, "event": line.event, "facts": line.facts}
            values = {"job_id": one.job_id, "attempt": one.attempt, "logged_ns": line.logged_ns, **said}
            session.execute(insert(JobLine).values(**values))

    def refuse(*_: object) -> None:
        raise ValueError("the lines are there")

    monkeypatch.setattr(leases, "write_lines", insert_again)
    monkeypatch.setattr(leases, "_renew_apart", refuse)
    assert "ended as silent" in found_from(1032).violation


def test_what_follows_a_success_and_is_left_out_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault of 23 November 2026: a run that was cancelled in a job's last moment and then retried never ended."""
    succeed, settle = execution.succeed, control.settle

    def leave_out(
        session: Session, claim: Claim, outcome: Outcome, most: int, words: AttemptWords | None = None
    ) -> bool:
        is_asked = bool(session.get_one(Job, claim.root_id, populate_existing=True).cancel_reason)
        return succeed(session, claim, replace(outcome, then=()) if is_asked else outcome, most, words)

    def settle_but_for_a_retry(session: Session, run: Job) -> None:
        if run.cancel_reason:
            settle(session, run)

    monkeypatch.setattr(execution, "succeed", leave_out)
    monkeypatch.setattr(control, "settle", settle_but_for_a_retry)
    assert "lost: " in found_from(1003).violation


def test_a_success_that_is_counted_off_in_jobs_it_brings_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault that these histories detected: if a job adds jobs `after` its own kind, one of them starts too early."""
    release, add_jobs, released = completion._release, completion.add_jobs, list[str]()

    def release_later(_session: Session, job_id: str) -> bool:
        released.append(job_id)
        return False  # a run checks for remaining jobs itself

    def add_jobs_first(session: Session, run: Job, specs: Sequence[JobSpec], most: int) -> list[Job]:
        jobs = add_jobs(session, run, specs, most)
        release(session, released.pop())
        return jobs

    monkeypatch.setattr(completion, "_release", release_later)
    monkeypatch.setattr(completion, "add_jobs", add_jobs_first)
    assert "waits for" in found_from(14).violation


@pytest.mark.parametrize("name", ["_release", "_note"])
def test_a_step_that_is_left_out_is_found(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    nothing: Callable[..., bool] = lambda *_: False  # noqa: E731
    monkeypatch.setattr(f"services.runtime.jobs.completion.{name}", nothing)
    assert found_from(3000).violation
