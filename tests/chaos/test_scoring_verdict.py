"""A submission that came to something else than an undisturbed one is told, whatever it is that differs."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import delete, update
from sqlalchemy.orm import Session

from chaos.scoring_verdict import SubmissionOutcome, came_of, judge, judge_quota
from services.runtime.orm import Job, JobAttempt, Score, ScoringEntry, SubmissionRow
from testing.worlds.benchmark_world import World, run_eval
from testing.worlds.sending import guess, row_of, send, standing_world, zipped


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[World]:
    with standing_world(tmp_path_factory.mktemp("verdict"), _sqlite_template) as made:
        yield made


@pytest.fixture(scope="module")
def content(world: World) -> bytes:
    return zipped(world, guess(world))


@pytest.fixture(scope="module")
def undisturbed(world: World, content: bytes) -> SubmissionOutcome:
    submission_id = send(world, content)
    run_eval(world.platform)
    return came_of(world.platform, submission_id)


@pytest.fixture
def submission(world: World, content: bytes, undisturbed: SubmissionOutcome) -> SubmissionRow:
    """Scored as the undisturbed one."""
    submission_id = send(world, content)
    run_eval(world.platform)
    assert judge(world.platform, submission_id, undisturbed) == []
    return row_of(world.platform, submission_id)


def no_score(session: Session, row: SubmissionRow) -> None:
    session.execute(delete(Score).where(Score.submission_id == row.id))


def another_state(session: Session, row: SubmissionRow) -> None:
    session.execute(update(SubmissionRow).where(SubmissionRow.id == row.id).values(state="scoring"))


def taken_twice(session: Session, row: SubmissionRow) -> None:
    session.add(
        ScoringEntry(phase_id=row.phase_id, team_id=row.team_id, submission_id=row.id, amount=1, reason="again")
    )


def done_twice(session: Session, row: SubmissionRow) -> None:
    job_id = session.query(Job.id).filter(Job.root_id == row.job_id, Job.queue != "").scalar()
    session.add(JobAttempt(job_id=job_id, number=7, worker="here:1", outcome="succeeded"))


def not_done(session: Session, row: SubmissionRow) -> None:
    session.execute(update(Job).where(Job.id == row.job_id).values(state="running"))


def not_kept(session: Session, row: SubmissionRow) -> None:
    session.execute(update(SubmissionRow).where(SubmissionRow.id == row.id).values(blob_sha256=None))


@pytest.mark.parametrize("spoil", [no_score, another_state, taken_twice, done_twice, not_done, not_kept])
def test_what_is_not_as_undisturbed_is_told(
    world: World,
    submission: SubmissionRow,
    undisturbed: SubmissionOutcome,
    spoil: Callable[[Session, SubmissionRow], None],
) -> None:
    with world.platform.database.transaction() as session:
        spoil(session, submission)
    assert judge(world.platform, submission.id, undisturbed) != []


def test_another_result_is_told(world: World, undisturbed: SubmissionOutcome) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=1)))
    run_eval(world.platform)
    assert [found.sort for found in judge(world.platform, submission_id, undisturbed)] == ["differing"]


def test_a_quota_that_does_not_fit_what_is_scored_is_told(world: World, content: bytes) -> None:
    row = row_of(world.platform, send(world, content, team=1))
    assert [found.sort for found in judge_quota(world.platform, row.phase_id, row.team_id)] == ["lost"], "reserved"
    run_eval(world.platform)
    assert list(judge_quota(world.platform, row.phase_id, row.team_id)) == []
    with world.platform.database.transaction() as session:
        taken_twice(session, row)
    assert [found.sort for found in judge_quota(world.platform, row.phase_id, row.team_id)] == ["lost"]
