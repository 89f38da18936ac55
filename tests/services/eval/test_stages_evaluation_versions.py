"""By another ground truth or metric it is counted again only where it must be, and none under way is forgotten."""

from collections.abc import Iterator

import numpy as np
import pytest

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.rescores.progress import rescore_progress
from services.domain.benchmarks.rescores.rescore import NewRescore, abandon, start_rescore
from services.domain.benchmarks.submissions import scoring_ranges
from services.eval.queue_handlers import handlers
from services.runtime.jobs.execution import run_next
from services.runtime.orm import Alarm, Job, Phase, Rescore, SubmissionRow
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.metric import METRIC_VERSION, OCCUPIED_VERSION, RATIOS
from testing.worlds.benchmark_world import World, new_truth, run_eval
from testing.worlds.sending import (
    counts_of,
    guess,
    jobs_of,
    pair_of,
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


@pytest.fixture
def rescored(world: World) -> Iterator[list[str]]:
    """Ids of re-scores that the test begins; they are given up after it."""
    begun: list[str] = []
    yield begun
    with world.platform.database.transaction() as session:
        for rescore_id in begun:
            abandon(session, session.get_one(Rescore, rescore_id), "the test is over")


def begin(world: World, evaluation_version: EvaluationVersion) -> tuple[str, str | None]:
    """The re-score of val by the evaluation version, and its run."""
    with world.platform.database.transaction() as session:
        phase = session.get_one(Phase, world.val)
        rescore, run = start_rescore(
            session, phase, NewRescore(evaluation_version, world.administrator.user_id, "a test")
        )
        return rescore.id, run.id if run else None


def kinds_of(platform: Platform, root_id: str | None) -> list[str]:
    with platform.database.reading() as session:
        return [job.kind for job in session.query(Job).filter(Job.root_id == root_id, Job.queue != "").order_by(Job.id)]


def occupied(world: World) -> EvaluationVersion:
    return EvaluationVersion(pair_of(world, "val").truth_id, OCCUPIED_VERSION)


def test_another_metric_is_read_from_the_kept_counts_without_the_file(world: World, rescored: list[str]) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=1)))
    run_eval(world.platform)
    with world.platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).blob_sha256 = None
    rescore_id, run_id = begin(world, occupied(world))
    rescored.append(rescore_id)
    run_eval(world.platform)
    assert kinds_of(world.platform, run_id) == ["eval.join"]
    first, second = scores_of(world.platform, submission_id)
    assert (first.metric, second.metric) == (METRIC_VERSION, OCCUPIED_VERSION)
    assert first.confusions_sha256 == second.confusions_sha256
    assert first.content_sha256 == second.content_sha256
    expected = ratios(np.array(first.record["confusion"]), OCCUPIED_VERSION).tolist()
    assert [getattr(second, name) for name in RATIOS] == expected
    assert first.miou != second.miou
    assert taken(world.platform, submission_id) == 1
    with world.platform.database.reading() as session:
        assert rescore_progress(session, session.get_one(Rescore, rescore_id)).is_complete


@pytest.mark.whole
@pytest.mark.parametrize("part_frames", [500, 1])
def test_another_ground_truth_is_counted_from_the_file(
    world: World, part_frames: int, rescored: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    submission_id = send(world, zipped(world, guess(world, turn=part_frames)))
    run_eval(world.platform)
    truth_id = new_truth(world.platform, world.val, world.administrator.user_id)
    rescore_id, _ = begin(world, EvaluationVersion(truth_id, METRIC_VERSION))
    rescored.append(rescore_id)
    run_eval(world.platform)
    (first,), second = (
        [one for one in scores_of(world.platform, submission_id) if one.truth_id == pair_of(world, "val").truth_id],
        scores_of(world.platform, submission_id)[-1],
    )
    assert second.truth_id == truth_id
    assert (first.record, first.signature) == (second.record, second.signature)
    assert np.array_equal(counts_of(world.platform, first)[0], counts_of(world.platform, second)[0])
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)
    assert parts_left(world.platform) == 0


def test_a_purged_file_is_not_counted_again_and_the_others_are(world: World, rescored: list[str]) -> None:
    """Its job finds nothing to count; the run goes on and the old score stands."""
    purged, kept = (send(world, zipped(world, guess(world, turn=turn))) for turn in (10, 11))
    run_eval(world.platform)
    truth_id = new_truth(world.platform, world.val, world.administrator.user_id)
    rescore_id, run_id = begin(world, EvaluationVersion(truth_id, METRIC_VERSION))
    rescored.append(rescore_id)
    with world.platform.database.transaction() as session:
        session.get_one(SubmissionRow, purged).blob_sha256 = None
    run_eval(world.platform)
    with world.platform.database.reading() as session:
        run = session.get_one(Job, run_id)
        refused = [job.result for job in session.query(Job).filter(Job.root_id == run_id, Job.queue != "")]
    assert run.state == "succeeded"
    assert refused.count({"refused": "submission_purged"}) == 1
    assert truth_id not in [one.truth_id for one in scores_of(world.platform, purged)]
    assert truth_id in [one.truth_id for one in scores_of(world.platform, kept)]
    assert row_of(world.platform, purged).state == "scored"


def test_a_submission_that_comes_during_a_rescore_is_scored_by_both_pairs(world: World, rescored: list[str]) -> None:
    rescored.append(begin(world, occupied(world))[0])
    submission_id = send(world, zipped(world, guess(world, turn=12)))
    run_eval(world.platform)
    assert [one.metric for one in scores_of(world.platform, submission_id)] == [METRIC_VERSION, OCCUPIED_VERSION]
    assert [job.kind for job in jobs_of(world.platform, submission_id)] == ["eval.open", "eval.join"]
    assert taken(world.platform, submission_id) == 1


def test_one_that_is_being_counted_when_a_rescore_begins_is_scored_by_both_pairs(
    world: World, rescored: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    submission_id = send(world, zipped(world, guess(world, turn=13)))
    run_next(world.platform, "eval", handlers(world.platform))
    assert row_of(world.platform, submission_id).state == "scoring"
    rescored.append(begin(world, occupied(world))[0])
    run_eval(world.platform)
    assert [one.metric for one in scores_of(world.platform, submission_id)] == [METRIC_VERSION, OCCUPIED_VERSION]


def test_equal_predictions_of_two_teams_raise_an_alarm_once(world: World) -> None:
    content = zipped(world, guess(world, turn=14))
    sent = [send(world, content, team=team) for team in (0, 1)]
    run_eval(world.platform)
    with world.platform.database.reading() as session:
        alarms = session.query(Alarm).filter(Alarm.subject.in_(sent)).all()
    assert [(row.kind, row.subject) for row in alarms] == [("equal_content", sent[1])]
