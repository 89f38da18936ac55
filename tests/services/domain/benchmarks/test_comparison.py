"""Two entries side by side: differences from paired draws, against those computed from the counts themselves."""

import numpy as np
import pytest

from services.domain.benchmarks.boards.comparison import EntryComparison, compare
from services.domain.benchmarks.submissions.result_errors import NotComparableError
from services.domain.benchmarks.visibility import ANYBODY, Viewer
from services.runtime.orm import SubmissionRow
from services.runtime.platform import Platform
from stone.scoring.bootstrap import BootstrapOptions, block_replicates, sequence_replicates
from stone.scoring.confusion import ratios
from stone.scoring.metric import RATIOS
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, SEQUENCES, Made, Scene, counts, scene

LENGTHS = [one.frames for one in SEQUENCES]
OPTIONS = BootstrapOptions(replicates=4000, block_frames=200, seed=0)


def compared(at: Scene, a: str, b: str, viewer: Viewer = ANYBODY) -> EntryComparison:
    with at.platform.database.reading() as session:
        both = session.get_one(SubmissionRow, a), session.get_one(SubmissionRow, b)
    return compare(at.platform, at.phase_id, both, viewer)


@pytest.mark.parametrize("kind", ["block", "sequence"])
def test_an_interval_is_that_of_the_same_resamples_of_both(platform: Platform, kind: str) -> None:
    at = scene(platform)
    made = (Made(0.30, 1), Made(0.31, 2))
    a_id, b_id = (at.enter(at.team(), one) for one in made)
    found = compared(at, a_id, b_id)
    resampled = block_replicates if kind == "block" else sequence_replicates
    a, b = (ratios(resampled(counts(one).sum(axis=1, dtype=np.int64), LENGTHS, OPTIONS)) for one in made)
    for difference, name in zip((a - b).T, RATIOS, strict=True):
        told = getattr(found.ratios[name], kind)
        assert told.interval == pytest.approx(np.quantile(difference, [0.025, 0.975]).tolist(), abs=1e-6)
        assert told.share_above == pytest.approx(np.mean(difference > 0), abs=0.002)


def test_totals_are_subtracted_and_the_better_one_is_found(platform_on: Platform) -> None:
    at = scene(platform_on)
    better, worse = at.enter(at.team(), Made(0.2)), at.enter(at.team(), Made(0.4))
    found = compared(at, better, worse).ratios["miou"]
    scores = [at.score_row(one).miou or 0 for one in (better, worse)]
    assert (found.a, found.b, found.difference) == (scores[0], scores[1], scores[0] - scores[1])
    assert found.block is not None
    assert found.block.interval is not None
    assert found.block.interval[0] > 0
    assert (found.block.share_above, found.block.p) == (1.0, 2 / 4001)


def test_three_sequences_say_how_little_they_can_say(platform: Platform) -> None:
    at = scene(platform)
    flip = compared(at, at.enter(at.team(), Made(0.2)), at.enter(at.team(), Made(0.4))).ratios["miou"].sign_flip
    assert flip is not None
    assert (flip.sequences, flip.p, flip.smallest_p) == (3, 0.25, 0.25)


def test_an_entry_does_not_differ_from_itself(platform: Platform) -> None:
    at = scene(platform)
    same = at.enter(at.team(), Made(0.3))
    found = compared(at, same, same).ratios["miou"]
    assert found.block is not None
    assert (found.difference, found.block.interval, found.block.p) == (0.0, (0.0, 0.0), 1.0)


def test_an_undefined_ratio_has_no_difference(platform: Platform) -> None:
    at = scene(platform)
    found = compared(at, at.enter(at.team(), Made(0.3, without=3)), at.enter(at.team(), Made(0.3))).ratios
    assert found["iou_n"].difference is None
    assert found["iou_n"].block is not None
    assert (found["iou_n"].block.interval, found["iou_n"].block.p) == (None, 1.0)
    assert found["iou_n"].sign_flip is None
    assert found["iou_t"].difference is not None


def test_while_the_truth_is_hidden_only_rounded_totals_are_subtracted(platform: Platform) -> None:
    at = scene(platform)
    team = at.team()
    a, b = at.enter(team, Made(total=(("miou", 0.500049),))), at.enter(team, Made(total=(("miou", 0.499951),)))
    at.hide()
    for viewer in (ANYBODY, Viewer(team_ids=frozenset({team}))):
        found = compared(at, a, b, viewer)
        told = found.ratios["miou"]
        assert (found.is_withheld, told.a, told.b, told.difference) == (True, 0.5, 0.5, 0.0)
        assert (told.block, told.sequence, told.sign_flip) == (None, None, None)
    assert compared(at, a, b, ADMINISTRATOR).ratios["miou"].difference == pytest.approx(0.000098)


def test_entries_of_another_phase_or_without_a_score_are_refused(platform: Platform) -> None:
    at, elsewhere = scene(platform), scene(platform)
    known, foreign = at.enter(at.team(), Made()), elsewhere.enter(elsewhere.team(), Made())
    unscored = at.enter(at.team(), None, state="failed")
    for other in (foreign, unscored):
        with pytest.raises(NotComparableError, match="must be scored entries of this phase"):
            compared(at, known, other)
