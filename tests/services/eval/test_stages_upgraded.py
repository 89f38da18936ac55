"""A score is counted by one version of the code, whatever was counted before the platform was upgraded."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import update

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.rescores.rescore import NewRescore, start_rescore
from services.domain.benchmarks.submissions import scoring_ranges
from services.eval import examination, join
from services.eval.examination import Counts
from services.eval.queue_handlers import handlers
from services.runtime import code_version
from services.runtime.jobs.execution import run_next
from services.runtime.orm import Activation, Phase, Score, ScorePart, SubmissionRow
from services.runtime.source_digests import SourceDigest
from stone.scoring.metric import METRIC_VERSION, METRICS, OCCUPIED_VERSION, RATIOS
from testing.worlds.benchmark_world import World, run_eval
from testing.worlds.sending import counts_of, guess, pair_of, parts_left, scores_of, send, standing_world, zipped


@pytest.fixture
def world(tmp_path: Path, _sqlite_template: Path) -> Iterator[World]:
    with standing_world(tmp_path, _sqlite_template) as made:
        yield made


def now() -> str:
    return code_version.code_version("scores")


def upgraded(monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on the sources that make scores are others."""
    monkeypatch.setitem(code_version._DIGESTS, "scores", SourceDigest("f" * 64, {}))


def scored_again(world: World, metric: str = OCCUPIED_VERSION) -> None:
    """By another metric, which may be read from kept counts."""
    with world.platform.database.transaction() as session:
        version = EvaluationVersion(pair_of(world, "val").truth_id, metric)
        start_rescore(
            session, session.get_one(Phase, world.val), NewRescore(version, world.administrator.user_id, "a test")
        )
    run_eval(world.platform)


def test_parts_that_another_version_counted_are_counted_again(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    content = zipped(world, guess(world, turn=1))
    undisturbed = send(world, content)
    run_eval(world.platform)
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    submission_id = send(world, content)
    stages = handlers(world.platform)
    assert run_next(world.platform, "eval", stages)  # opened
    assert run_next(world.platform, "eval", stages)
    assert parts_left(world.platform) == 1
    wrong = Counts(np.ones((1, 3, 4, 4), np.int32), np.ones((1, 3, 3), np.int32)).packed()
    with world.platform.database.transaction() as session:
        session.execute(update(ScorePart).values(counts=wrong))
    upgraded(monkeypatch)
    run_eval(world.platform)
    (expected,), (found,) = scores_of(world.platform, undisturbed), scores_of(world.platform, submission_id)
    assert found.record["code_version"] == now() != expected.record["code_version"]
    assert np.array_equal(counts_of(world.platform, found)[0], counts_of(world.platform, expected)[0])
    assert parts_left(world.platform) == 0


def test_what_another_version_kept_is_counted_again_from_the_file(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=2)))
    run_eval(world.platform)
    upgraded(monkeypatch)
    monkeypatch.setattr(join, "_kept_counts", lambda path: pytest.fail("read what the old code counted"))
    scored_again(world)
    assert versions_of(world, submission_id)[1:] == [now()]


def test_where_the_file_is_gone_a_score_bears_the_version_of_what_was_kept(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission_id, before = send(world, zipped(world, guess(world, turn=3))), now()
    run_eval(world.platform)
    with world.platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).blob_sha256 = None
    upgraded(monkeypatch)
    scored_again(world)
    assert versions_of(world, submission_id) == [before, before]


def versions_of(world: World, submission_id: str) -> list[str]:
    scores: list[Score] = scores_of(world.platform, submission_id)
    return [score.record["code_version"] for score in scores]


@pytest.mark.parametrize("current", [METRIC_VERSION, OCCUPIED_VERSION])
def test_a_phase_whose_intervals_are_withdrawn_gets_some_that_hold_from_what_is_kept(
    world: World, current: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = next(metric.version for metric in METRICS.values() if metric.successor == current)
    truth_id = pair_of(world, "val").truth_id
    with world.platform.database.transaction() as session:
        user_id = world.administrator.user_id
        session.add(Activation(phase_id=world.val, truth_id=truth_id, metric=before, activated_by=user_id))
    submission_id = send(world, zipped(world, guess(world, turn=4)))
    run_eval(world.platform)
    monkeypatch.setattr(examination, "examine", lambda *_: pytest.fail("the file was read again"))
    scored_again(world, current)
    old, new = scores_of(world.platform, submission_id)
    assert (old.metric, new.metric) == (before, current)
    assert {name: getattr(old, name) for name in RATIOS} == {name: getattr(new, name) for name in RATIOS}
    withdrawn = [set(score.record["silences"]["these_places"].values()) for score in (old, new)]
    assert withdrawn[0] == {"withdrawn"}
    assert "withdrawn" not in withdrawn[1]
