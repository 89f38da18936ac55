"""Whatever is delivered again, lost, late or scored by another version: one score for each, one scoring taken."""

from dataclasses import dataclass

import pytest
from sqlalchemy import func, select, update

from services.domain.benchmarks.submissions import scoring_ranges
from services.domain.benchmarks.submissions.chores import settle_ended
from services.domain.benchmarks.submissions.states import reopen
from services.eval.stages import handlers
from services.runtime.jobs.claims import Claim, claim
from services.runtime.jobs.completion import Failure, lose, succeed
from services.runtime.jobs.control import retry
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Job, Score, ScoringEntry
from services.runtime.platform import Platform
from testing.worlds.benchmark_world import World, run_eval
from testing.worlds.sending import (
    guess,
    jobs_of,
    parts_left,
    row_of,
    scores_of,
    send,
    taken,
    zipped,
)


@pytest.fixture(scope="module")
def world(standing: World) -> World:
    return standing


@dataclass(frozen=True)
class Quiet:
    """An attempt that says nothing."""

    claim: Claim

    @property
    def job_id(self) -> str:
        return self.claim.job_id

    @property
    def root_id(self) -> str:
        return self.claim.root_id

    @property
    def sequence_id(self) -> str | None:
        return None

    @property
    def arguments(self) -> dict[str, object]:
        return self.claim.arguments

    def progress(self, stage: str, done: int, total: int) -> None:
        """Nobody listens."""

    def log(self, event: str, level: str = "info", **facts: object) -> None:
        """Nobody reads."""


def told(platform: Platform) -> tuple[int, int, int]:
    """How many scores, entries of the ledger and parts there are."""
    with platform.database.reading() as session:
        scores, entries = (session.scalar(select(func.count()).select_from(row)) or 0 for row in (Score, ScoringEntry))
    return scores, entries, parts_left(platform)


def deliver_again(platform: Platform, submission_id: str) -> None:
    """Every job of its run stands in the queue as if it had never been done."""
    root_id = row_of(platform, submission_id).job_id
    with platform.database.transaction() as session:
        again = update(Job).where(Job.root_id == root_id, Job.queue != "")
        session.execute(again.values(state="queued", needs_left=0, attempts_left=3))


@pytest.mark.parametrize("part_frames", [500, 1])
def test_jobs_that_are_delivered_again_change_nothing(
    world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    submission_id = send(world, zipped(world, guess(world, turn=part_frames)))
    run_eval(world.platform)
    (score,), before = scores_of(world.platform, submission_id), told(world.platform)
    deliver_again(world.platform, submission_id)
    assert run_eval(world.platform) == len(jobs_of(world.platform, submission_id))
    assert {job.state for job in jobs_of(world.platform, submission_id)} == {"succeeded"}
    assert told(world.platform) == before
    assert [row.id for row in scores_of(world.platform, submission_id)] == [score.id]
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)


@pytest.mark.parametrize("part_frames", [500, 1])
def test_an_attempt_that_was_given_up_writes_nothing_when_it_ends_after_all(
    world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each job is worked at twice at once: its first worker falls silent, ends last, and is not heard."""
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    submission_id = send(world, zipped(world, guess(world, turn=20 + part_frames)))
    late: list[tuple[Claim, Outcome]] = []
    stages = handlers(world.platform)
    while (first := fallen_silent(world.platform)) is not None:
        late.append((first, stages[first.kind](Quiet(first))))
        assert run_next(world.platform, "eval", stages)
    before = told(world.platform)
    with world.platform.database.transaction() as session:
        assert not any(succeed(session, held, outcome, 3) for held, outcome in late)
    assert len(late) == len(jobs_of(world.platform, submission_id))
    assert {job.attempt for job in jobs_of(world.platform, submission_id)} == {2}
    assert told(world.platform) == before
    assert len(scores_of(world.platform, submission_id)) == 1
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)


def fallen_silent(platform: Platform) -> Claim | None:
    """A job that was claimed, and then given back to the queue because nothing was heard of it."""
    with platform.database.transaction() as session:
        held = claim(session, "eval")
    if held is not None:
        with platform.database.transaction() as session:
            assert lose(session, held, Failure("worker_lost", "no sign of life"))
    return held


def test_a_worker_that_is_lost_too_often_costs_the_team_nothing_and_can_be_tried_again(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=30)))
    while fallen_silent(world.platform) is not None:
        pass
    assert settle_ended(world.platform) == 1
    row = row_of(world.platform, submission_id)
    assert (row.state, row.failure_code, taken(world.platform, submission_id)) == ("failed", "worker_lost", 0)
    with world.platform.database.transaction() as session:
        reopen(session, retry(session, row.job_id or "", 3))
    run_eval(world.platform)
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)
    assert len(scores_of(world.platform, submission_id)) == 1


def test_a_fault_of_the_store_is_tried_again(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=31)))
    stages, failed = handlers(world.platform), list[str]()

    def at_first_away(attempt: Attempt) -> Outcome:
        if not failed:
            failed.append(attempt.job_id)
            raise OSError(5, "Input/output error")
        return stages["eval.open"](attempt)

    while run_next(world.platform, "eval", {**stages, "eval.open": at_first_away}):
        pass
    assert [job.attempt for job in jobs_of(world.platform, submission_id)] == [2]
    assert row_of(world.platform, submission_id).state == "scored"
