"""The swept footprint against a loop over voxels and poses, and how much of the way is T."""

import math
import tracemalloc
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.map.track_coverage import coverage_findings
from stone.geometry.lattice import centres_of, keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.footprint import BAND_M, STEP_M, STEP_RAD, _reached, densified, passed_through, passes
from stone.labels.track_coverage import STEP_M as SPACING_M
from stone.labels.track_coverage import TrackCoverage, coverage, covered_places, places_of, spaced
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Footprint

FOOTPRINT = Footprint()


def block(low, high):
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    return keys_from_indices(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))


def path(*rows):
    """Poses of rows (x, y, z, yaw)."""
    return SE3(np.array([[math.cos(w / 2), 0, 0, math.sin(w / 2), x, y, z] for x, y, z, w in rows]))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32))
def test_what_is_swept_is_what_lies_under_any_pose(seed):
    rng = np.random.default_rng(seed)
    tilt = rng.normal(size=(4, 3)) * [0.2, 0.2, 1.0]
    wxyz = np.concatenate([np.ones((4, 1)), tilt], axis=1)
    poses = SE3.from_parts(wxyz, rng.uniform(-1.0, 1.0, (4, 3)) * [1, 1, 0.2])
    keys = block((-12, -12, -6), (12, 12, 6))
    inside = np.zeros(len(keys), np.bool_)
    for pose in densified(poses, STEP_M, STEP_RAD).wxyz_xyz:
        x, y, z = np.abs(SE3(pose).inverse() @ centres_of(keys, VOXEL_M)).T
        inside |= (x <= FOOTPRINT.length_m / 2) & (y <= FOOTPRINT.width_m / 2) & (z <= BAND_M)
    assert (passes(keys, [poses], FOOTPRINT).is_driven == inside).all()


def test_a_straight_drive_over_a_plane_covers_exactly_its_rectangle():
    keys = block((-40, -10, 0), (40, 10, 1))
    x, y, _ = centres_of(keys, VOXEL_M).T
    expected = (x >= -2.04 - 0.53) & (x <= 3.04 + 0.53) & (np.abs(y) <= 0.425)
    under = passes(keys, [path((-2.04, 0, 0.1, 0), (3.04, 0, 0.1, 0))], FOOTPRINT).is_driven
    assert (under == expected).all()
    assert under.sum() == 31 * 4


def test_voxels_beyond_the_band_are_not_driven_on():
    keys = block((-2, -2, -5), (2, 2, 5))
    under = passes(keys, [path((0, 0, 0, 0))], FOOTPRINT, band_m=0.15).is_driven
    assert set(centres_of(keys[under], VOXEL_M)[:, 2].round(3)) == {-0.1, 0.1}


def test_nothing_is_driven_between_two_stretches():
    keys = block((-5, -2, 0), (60, 2, 1))
    x, _, _ = centres_of(keys, VOXEL_M).T
    under = passes(
        keys, [path((0, 0, 0.1, 0), (1, 0, 0.1, 0)), path((8, 0, 0.1, 0), (10, 0, 0.1, 0))], FOOTPRINT
    ).is_driven
    assert under[(x <= 1.53) | ((x >= 7.47) & (x <= 10.53))].sum() == under.sum()
    assert not under[(x > 1.53) & (x < 7.47)].any()


def test_a_robot_that_turns_on_the_spot_sweeps_a_disc_with_its_corners():
    keys = block((-6, -6, 0), (6, 6, 1))
    x, y, _ = centres_of(keys, VOXEL_M).T
    quarter_turns = path(*[(0, 0, 0.1, math.radians(angle)) for angle in (0, 90, 180)])
    reach_m = math.hypot(FOOTPRINT.length_m, FOOTPRINT.width_m) / 2
    assert passes(keys, [quarter_turns], FOOTPRINT).is_driven[np.hypot(x, y) <= reach_m - 0.01].all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 8), st.floats(0.05, 2))
def test_densified_poses_keep_the_given_ones_and_are_close_together(seed, count, step_m):
    rng = np.random.default_rng(seed)
    poses = SE3.from_parts(rng.normal(size=(count, 4)), rng.uniform(-2, 2, (count, 3)))
    dense = densified(poses, step_m)
    gaps = np.linalg.norm(np.diff(dense.translation_m, axis=0), axis=1)
    assert gaps.max() <= step_m + 1e-9
    for pose in poses.translation_m:
        assert np.linalg.norm(dense.translation_m - pose, axis=1).min() < 1e-12


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_poses_have_nothing_between(count):
    poses = SE3.identity((count,))
    assert len(densified(poses, 0.1)) == count
    keys = block((-3, -3, 0), (3, 3, 1))
    assert passes(keys, [poses], FOOTPRINT).is_driven.any() == (count == 1)
    assert passes(keys[:0], [poses], FOOTPRINT).is_driven.shape == (0,)


def test_the_body_goes_through_what_is_above_its_clearance_and_below_its_top():
    keys = block((-12, -8, -2), (12, 8, 20))
    x, y, z = centres_of(keys, 0.1).T
    passed = passed_through(keys, 0.1, [path((0, 0, 0, 0), (0.6, 0, 0, 0))], FOOTPRINT, (0.3, 1.2))
    expected = (x >= -0.53) & (x <= 1.13) & (np.abs(y) <= 0.425) & (z >= 0.3) & (z <= 1.2)
    assert (passed == expected).all()
    assert not passed_through(keys, 0.1, [path((0, 0, 0, 0))], FOOTPRINT, (0.3, 0.2)).any()


@pytest.mark.parametrize("voxel_m", [0.1, VOXEL_M])
def test_what_is_looked_at_is_as_flat_as_the_footprint(voxel_m):
    """A cube around 50 m of it was 343 million voxels a pose."""
    pose = path((3.0, -2.0, 0.4, 0.3)).as_matrix()[0]
    spans = [_reached.py_func(pose[axis], (25.0, 25.0, -0.15, 0.15, voxel_m)) for axis in range(3)]
    x, y, z = (end - first for first, end in spans)
    assert max(x, y) <= 50 * (math.cos(0.3) + math.sin(0.3)) / voxel_m + 4
    assert z <= 0.3 / voxel_m + 4


WIDE = np.array(list(product(range(-20, 60), range(-20, 20), (0,))), np.int64)
WAY = SE3.from_parts(np.tile([1.0, 0, 0, 0], (81, 1)), np.linspace([0.03, 0.02, 0.1], [8.03, 0.02, 0.1], 81))


def keys(indices) -> np.ndarray:
    return np.sort(keys_from_indices(np.asarray(indices, np.int64)))


def without(*gone) -> np.ndarray:
    """The floor without the columns (i, j)."""
    is_gone = (WIDE[:, None, :2] == np.array(gone)).all(axis=2).any(axis=1)
    return keys(WIDE[~is_gone])


def test_a_floor_that_is_driven_on_everywhere_is_covered_and_so_is_what_sweeping_marks():
    floor = keys(WIDE)
    for driven in (floor, floor[passes(floor, (WAY,), FOOTPRINT).is_driven]):
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
    assert steps_m.min() > SPACING_M - 0.11
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
    assert coverage_findings(TrackCoverage(1000, 801, 20, 0), 0.15) == ()
    (finding,) = coverage_findings(TrackCoverage(1000, 700, 20, 2), 0.15)
    assert (finding.code, finding.severity) == ("LAB-607", "warning")
    assert all(number in finding.message for number in ("30.0%", "2 of 20", "0.15 m"))


@pytest.mark.whole
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
