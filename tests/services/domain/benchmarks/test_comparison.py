"""Two entries side by side: differences frame by frame, against those computed from the counts themselves."""

import numpy as np
import pytest

from services.domain.benchmarks.boards.comparison import EntryComparison, compare
from services.domain.benchmarks.submissions.result_errors import NotComparableError
from services.domain.benchmarks.visibility import ANYBODY, Viewer
from services.runtime.orm import SubmissionRow
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.intervals import estimates, ratio_spectra
from stone.scoring.metric import RATIOS
from stone.scoring.silences import SCOPES, Scope
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, SEQUENCES, Made, Scene, counts, scene

LENGTHS = [one.frames for one in SEQUENCES]


def compared(at: Scene, a: str, b: str, viewer: Viewer = ANYBODY) -> EntryComparison:
    with at.platform.database.reading() as session:
        both = session.get_one(SubmissionRow, a), session.get_one(SubmissionRow, b)
    return compare(at.platform, at.phase_id, both, viewer)


@pytest.mark.parametrize("scope", SCOPES)
def test_a_difference_is_that_of_the_counts_themselves(platform: Platform, scope: Scope) -> None:
    at = scene(platform)
    made = (Made(0.30, 1), Made(0.31, 2))
    a_id, b_id = (at.enter(at.team(), one) for one in made)
    found = compared(at, a_id, b_id)
    by_frame = [counts(one).sum(axis=1, dtype=np.int64) for one in made]
    a, b = (ratios(confusions.sum(axis=0)) for confusions in by_frame)
    spectra = ratio_spectra(by_frame[0], LENGTHS).minus(ratio_spectra(by_frame[1], LENGTHS))
    for name, expected in zip(RATIOS, estimates(a - b, spectra, scope), strict=True):
        told, silences = getattr(found.ratios[name], scope), found.ratios[name].silences
        if isinstance(expected, str):
            assert (told, silences[scope]) == (None, expected)
            continue
        assert silences[scope] is None
        assert told.interval == pytest.approx(expected.interval(), abs=1e-6)
        assert (told.p, told.degrees_of_freedom) == pytest.approx((expected.p, expected.degrees), rel=1e-3)
    assert found.ratios["miou"].silences == {"these_places": None, "new_place": "few_sequences"}


def test_totals_are_subtracted_and_the_better_one_is_found(platform: Platform) -> None:
    at = scene(platform)
    better, worse = at.enter(at.team(), Made(0.2)), at.enter(at.team(), Made(0.4))
    found = compared(at, better, worse).ratios["miou"]
    scores = [at.score_row(one).miou or 0 for one in (better, worse)]
    assert (found.a, found.b, found.difference) == (scores[0], scores[1], scores[0] - scores[1])
    assert 0 < found.these_places.interval[0] < (found.difference or 0) < found.these_places.interval[1]
    assert found.these_places.p < 1e-6


def test_three_sequences_say_how_little_they_can_say(platform: Platform) -> None:
    at = scene(platform)
    flip = compared(at, at.enter(at.team(), Made(0.2)), at.enter(at.team(), Made(0.4))).ratios["miou"].sign_flip
    assert (flip.sequences, flip.p, flip.smallest_p) == (3, 0.25, 0.25)


def test_an_entry_does_not_differ_from_itself(platform: Platform) -> None:
    at = scene(platform)
    same = at.enter(at.team(), Made(0.3))
    found = compared(at, same, same).ratios["miou"]
    assert (found.difference, found.these_places) == (0.0, None)
    assert found.silences == {"these_places": "no_wander", "new_place": "few_sequences"}


def test_of_scores_whose_intervals_are_withdrawn_nothing_is_told(platform: Platform) -> None:
    at = scene(platform)
    old, new = at.enter(at.team(), Made(0.2, is_withdrawn=True)), at.enter(at.team(), Made(0.4))
    found = compared(at, old, new).ratios["miou"]
    assert (found.these_places, found.new_place) == (None, None)
    assert found.silences == dict.fromkeys(SCOPES, "withdrawn")
    assert (found.difference or 0) > 0


def test_an_undefined_ratio_has_no_difference(platform: Platform) -> None:
    at = scene(platform)
    found = compared(at, at.enter(at.team(), Made(0.3, without=3)), at.enter(at.team(), Made(0.3))).ratios
    assert found["iou_n"].difference is None
    assert (found["iou_n"].these_places, found["iou_n"].new_place) == (None, None)
    assert found["iou_n"].silences == dict.fromkeys(SCOPES, "undefined")
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
        assert (told.these_places, told.new_place, told.silences, told.sign_flip) == (None, None, None, None)
    assert compared(at, a, b, ADMINISTRATOR).ratios["miou"].difference == pytest.approx(0.000098)


def test_entries_of_another_phase_or_without_a_score_are_refused(platform: Platform) -> None:
    at, elsewhere = scene(platform), scene(platform)
    known, foreign = at.enter(at.team(), Made()), elsewhere.enter(elsewhere.team(), Made())
    unscored = at.enter(at.team(), None, state="failed")
    for other in (foreign, unscored):
        with pytest.raises(NotComparableError, match="must be scored entries of this phase"):
            compared(at, known, other)
