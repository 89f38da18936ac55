"""Results of one submission and of two side by side, against those computed from the counts themselves."""

import io

import numpy as np
import pytest

from services.domain.benchmarks.boards.comparison import EntryComparison, compare
from services.domain.benchmarks.submissions.results import (
    BY,
    By,
    breakdown,
    kept_confusions,
    results,
    seen_score,
)
from services.domain.benchmarks.visibility import ANYBODY, Viewer
from services.runtime.orm import SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.intervals import SCOPES, Scope, estimates, ratio_spectra
from stone.scoring.metric import RATIOS
from testing.refusals import refused_as
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, FRAMES, SEQUENCES, Made, Scene, counts, scene

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
        with refused_as("not_comparable"):
            compared(at, known, other)


@pytest.mark.parametrize("by", BY)
def test_the_parts_of_a_result_are_ratios_of_their_own_counts(platform: Platform, by: By) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.3))
    with platform.database.reading() as session:
        seen = seen_score(session, ADMINISTRATOR, session.get_one(SubmissionRow, submission_id))
        parts = breakdown(seen, by)
    confusions = counts(Made(0.3))
    starts = {one.name: 450 * place for place, one in enumerate(SEQUENCES)}
    for place, part in enumerate(parts):
        if by == "distance":
            own = confusions[:, place].sum(axis=0, dtype=np.int64)
        else:
            members = [one for one in SEQUENCES if getattr(one, "name" if by == "sequence" else by) == part.name]
            frames = np.concatenate([np.arange(starts[one.name], starts[one.name] + one.frames) for one in members])
            own = confusions[frames].sum(axis=(0, 1), dtype=np.int64)
            assert part.frames == len(frames)
        assert [part.ratios[name] for name in RATIOS] == pytest.approx(ratios(own).tolist())
        assert list(part.support.values()) == own.sum(axis=1).tolist()
    assert len(parts) == {"sequence": 3, "environment": 2, "illumination": 2, "distance": 3}[by]


def test_the_kept_counts_are_those_that_were_made(platform: Platform) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.3))
    with platform.database.reading() as session:
        seen = seen_score(session, ADMINISTRATOR, session.get_one(SubmissionRow, submission_id))
        blob = kept_confusions(session, seen)
    with np.load(io.BytesIO(b"".join(platform.store.read(blob.object_key)))) as arrays:
        assert np.array_equal(arrays["confusions"], counts(Made(0.3)))
        assert arrays["bev"].shape == (FRAMES, 3, 3)


def test_a_result_is_by_the_pair_in_force_and_older_ones_stay_readable(platform: Platform) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.4))
    old = at.score_row(submission_id).id
    new = at.score(submission_id, Made(0.2), at.another_pair(activated_ns=now_ns()))
    with platform.database.reading() as session:
        row = session.get_one(SubmissionRow, submission_id)
        now, before = results(session, ADMINISTRATOR, row), results(session, ADMINISTRATOR, row, old)
    assert (now.seen.score.id, before.seen.score.id) == (new, old)
    assert (now.seen.is_active, before.seen.is_active) == (True, False)
    assert (now.total["miou"] or 0) > (before.total["miou"] or 0)
    assert (now.seen.truth.number, before.seen.truth.number) == (2, 1)


def test_of_a_score_from_before_silences_were_told_no_interval_is(platform: Platform) -> None:
    at = scene(platform)
    entered = at.enter(at.team(), Made(0.3, is_withdrawn=True))
    with platform.database.reading() as session:
        found = results(session, ANYBODY, session.get_one(SubmissionRow, entered))
    assert found.total["miou"] is not None
    assert found.intervals == dict.fromkeys(SCOPES, dict.fromkeys(RATIOS))
    assert found.silences == dict.fromkeys(SCOPES, dict.fromkeys(RATIOS, "withdrawn"))


def test_a_score_of_before_tells_the_danger_that_its_confusion_has_and_nothing_of_columns(platform: Platform) -> None:
    at = scene(platform)
    entered = at.enter(at.team(), Made(0.3, is_withdrawn=True))
    with platform.database.reading() as session:
        found = results(session, ANYBODY, session.get_one(SubmissionRow, entered))
    of_n = counts(Made(0.3)).sum(axis=(0, 1), dtype=np.int64)[3]
    assert found.extras is not None
    assert found.extras["n_predicted_drivable_ratio"] == (of_n[1] + of_n[2]) / of_n.sum()
    assert (found.extras["clear_drivable_iou"], found.tolerant, found.columns) == (None, None, None)
