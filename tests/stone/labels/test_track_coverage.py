"""How much of the way is T, on ground where every voxel is known."""

import tracemalloc
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.map.track_coverage import coverage_findings
from stone.geometry.lattice import keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.footprint import swept
from stone.labels.track_coverage import STEP_M, TrackCoverage, coverage, covered_places, places_of, spaced
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Footprint

FOOTPRINT = Footprint()
WIDE = np.array(list(product(range(-20, 60), range(-20, 20), (0,))), np.int64)
WAY = SE3.from_parts(np.tile([1.0, 0, 0, 0], (81, 1)), np.linspace([0.03, 0.02, 0.1], [8.03, 0.02, 0.1], 81))


def keys(indices) -> np.ndarray:
    return np.sort(keys_from_indices(np.asarray(indices, np.int64)))


def without(*gone) -> np.ndarray:
    """The floor without the columns (i, j)."""
    is_gone = (WIDE[:, None, :2] == np.array(gone)).all(axis=2).any(axis=1)
    return keys(WIDE[~is_gone])


def test_a_floor_that_is_driven_on_everywhere_is_covered():
    assert coverage(keys(WIDE), WAY, FOOTPRINT).closed_ratio == 1.0


def test_what_lies_inside_the_footprint_is_what_sweeping_marks():
    driven = keys(WIDE)[swept(keys(WIDE), (WAY,), FOOTPRINT)]
    assert coverage(driven, WAY, FOOTPRINT).closed_ratio == 1.0


def test_one_missing_column_is_a_pinhole_and_two_are_a_gap():
    for gone, is_closed in (
        ([(10, 0)], True),
        ([(10, 0), (11, 1)], True),
        ([(10, 0), (11, 0), (10, 1), (11, 1)], False),
    ):
        own, closed = covered_places(without(*gone), WAY, FOOTPRINT)
        assert not own.all()
        assert closed.all() == is_closed


@pytest.mark.parametrize(("higher", "is_covered"), [(-2, False), (-1, True), (0, True), (1, True), (2, False)])
def test_t_counts_one_voxel_above_and_below(higher, is_covered):
    own, _ = covered_places(keys(WIDE + np.array([0, 0, higher])), WAY, FOOTPRINT)
    assert own.all() == is_covered
    assert own.any() == is_covered


def test_a_stretch_without_t_is_bare():
    found = coverage(keys(WIDE[(WIDE[:, 0] < 10) | (WIDE[:, 0] > 30)]), spaced(WAY), FOOTPRINT)
    assert found.poses == 17
    assert found.bare == 7  # where the whole footprint lies between x = 2.0 and 6.2 m
    assert 0.4 < found.closed_ratio < 0.6
    assert found.bare_ratio == pytest.approx(7 / 17)


def test_nothing_driven_is_all_bare_and_no_way_is_none():
    assert coverage(np.zeros(0, np.int64), WAY, FOOTPRINT).bare_ratio == 1.0
    nobody = coverage(keys(WIDE), WAY[:0], FOOTPRINT)
    assert (nobody.closed_ratio, nobody.bare_ratio, nobody.poses) == (1.0, 0.0, 0)


def test_the_parts_of_a_way_add_to_the_whole():
    driven = without((10, 0), (11, 0), (10, 1))
    parts = coverage(driven, WAY[:30], FOOTPRINT) + coverage(driven, WAY[30:], FOOTPRINT)
    assert parts == coverage(driven, WAY, FOOTPRINT)


def test_a_footprint_of_one_voxel_is_its_middle_line():
    assert places_of(Footprint(0.1, 0.1)).tolist() == [[0.0, 0.0, 0.0]]
    assert len(places_of(Footprint(1.0, 0.1))) > 1


def test_poses_are_spaced_by_the_way_and_the_first_stays():
    steps_m = np.linalg.norm(np.diff(spaced(WAY).translation_m, axis=0), axis=1)
    assert steps_m.min() > STEP_M - 0.11
    assert len(spaced(WAY[:1])) == 1


@settings(max_examples=25, deadline=None)
@given(st.sets(st.tuples(st.integers(-4, 12), st.integers(-4, 4)), max_size=40), st.floats(-3.1, 3.1))
def test_the_slow_way_agrees(gone, yaw_rad):
    """An oracle: place by place, over a set of columns."""
    left = {(i, j) for i, j, _ in WIDE.tolist()} - gone
    pose = SE3.from_parts(np.array([np.cos(yaw_rad / 2), 0, 0, np.sin(yaw_rad / 2)]), np.array([0.7, 0.1, 0.1]))
    own, closed = covered_places(keys([(i, j, 0) for i, j in left]), SE3(pose.wxyz_xyz[None]), FOOTPRINT)
    for at, place in enumerate(pose @ places_of(FOOTPRINT)):
        i, j = (int(n) for n in np.floor(place[:2] / VOXEL_M))
        beside = {step for step in ((-1, 0), (1, 0), (0, -1), (0, 1)) if (i + step[0], j + step[1]) in left}
        is_own = (i, j) in left
        assert own[0, at] == is_own
        assert closed[0, at] == (is_own or beside >= {(-1, 0), (1, 0)} or beside >= {(0, -1), (0, 1)})


def test_a_way_that_holds_too_little_t_is_a_finding():
    assert coverage_findings(TrackCoverage(1000, 981, 20, 0), 0.15) == ()
    (finding,) = coverage_findings(TrackCoverage(1000, 900, 20, 2), 0.15)
    assert (finding.code, finding.severity) == ("LAB-607", "warning")
    assert "10.0%" in finding.message
    assert "2 of 20 poses" in finding.message
    assert "±0.15 m" in finding.message


def test_a_footprint_as_large_as_a_calibration_may_say_is_looked_at_in_pieces():
    """500 poses of 20 × 20 m at a time were gigabytes."""
    large = Footprint(20.0, 20.0)
    tracemalloc.start()
    found = coverage(keys(WIDE), WAY[:40], large)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.places == 40 * len(places_of(large))
    assert 0 < found.closed < found.places
    assert peak_bytes < 64 * 2**20
