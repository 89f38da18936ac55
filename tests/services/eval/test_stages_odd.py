"""Jobs about things that are gone or not there yet, and a platform whose bytes lie in a bucket."""

import pytest

from services.eval.cases import truth_of
from services.eval.scoring_errors import TruthUnreadyError
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import GroundTruthRow, Job
from services.runtime.settings import Settings, StoreSettings
from testing.servers.fixtures import opened
from testing.worlds.benchmark_world import World, benchmark_world, run_eval
from testing.worlds.sending import guess, jobs_of, pair_of, row_of, scores_of, send, taken, zipped

NOBODY = "0" * 32


@pytest.fixture(scope="module")
def world(standing: World) -> World:
    return standing


def ran(world: World, kind: str, **arguments: object) -> Job:
    """The job after it was run by itself."""
    with world.platform.database.transaction() as session:
        job_id = enqueue(session, JobSpec(kind, arguments), Context(world.administrator.user_id)).id
    run_eval(world.platform)
    with world.platform.database.reading() as session:
        return session.get_one(Job, job_id)


@pytest.mark.parametrize("kind", ["eval.open", "eval.part", "eval.join"])
def test_a_job_of_a_submission_that_is_gone_ends_cancelled(world: World, kind: str) -> None:
    truth_id = pair_of(world, "val").truth_id
    job = ran(world, kind, submission_id=NOBODY, truth_id=truth_id, start=0, stop=1, metric="stone-iou-2")
    assert (job.state, job.attempt) == ("cancelled", 1)


def test_a_job_of_a_ground_truth_that_is_gone_ends_cancelled(world: World) -> None:
    assert ran(world, "eval.truth", truth_id=NOBODY).state == "cancelled"


def test_nothing_is_scored_against_a_ground_truth_that_is_not_ready(world: World) -> None:
    ready = pair_of(world, "val").truth_id
    with world.platform.database.transaction() as session:
        row = session.get_one(GroundTruthRow, ready)
        unready = GroundTruthRow(phase_id=row.phase_id, number=99, dataset_id=row.dataset_id, part="val", mask="all")
        unready.created_by = row.created_by
        session.add(unready)
        session.flush()
        for truth_id in (unready.id, NOBODY):
            with pytest.raises(TruthUnreadyError, match="has no ground truth that is ready"):
                truth_of(session, truth_id)
    submission_id = send(world, zipped(world, guess(world, turn=1)))
    run_eval(world.platform)
    ended = ran(world, "eval.join", submission_id=submission_id, truth_id=unready.id, metric="stone-iou-2")
    assert (ended.state, ended.result) == ("succeeded", {"refused": "ground_truth_unready"})
    assert row_of(world.platform, submission_id).state == "scored", "what it has, it keeps"


def test_a_metric_that_nobody_knows_is_refused_and_the_score_stands(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=2)))
    run_eval(world.platform)
    truth_id = pair_of(world, "val").truth_id
    ended = ran(world, "eval.join", submission_id=submission_id, truth_id=truth_id, metric="stone-iou-0")
    assert (ended.state, ended.result) == ("succeeded", {"refused": "unknown_metric"})
    assert [score.metric for score in scores_of(world.platform, submission_id)] == ["stone-iou-2"]


def test_it_is_scored_from_a_bucket(settings: Settings, s3_settings: StoreSettings) -> None:
    platform = opened(settings.model_copy(update={"store": s3_settings}), [])
    world = benchmark_world(platform, frames=1)
    submission_id = send(world, zipped(world, guess(world)))
    run_eval(platform)
    assert (row_of(platform, submission_id).state, taken(platform, submission_id)) == ("scored", 1)
    assert [job.kind for job in jobs_of(platform, submission_id)] == ["eval.open"]
    assert len(scores_of(platform, submission_id)) == 1
    platform.database.close()
