"""The point map against a dict of lists, and that its bits do not depend on order or grouping."""

import math
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import indices_of, keys_of
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.surface import pointmap
from stone.surface.pointmap import QUANTUM_M, PointMapBuilder, merge
from testing.refusals import refused_as

VOXEL_M = 0.1
SENSOR_EGO = np.array([0.3, -0.1, 1.2])
SEEDS = st.integers(0, 2**32)


def sweeps_of(seed, count=5, points=400):
    """(points in the ego frame, pose) of so many sweeps that hit the same few voxels."""
    rng = np.random.default_rng(seed)
    wxyz, xyz = rng.normal(size=(count, 4)), rng.uniform(-0.3, 0.3, (count, 3))
    poses = SE3.from_parts(wxyz, xyz + np.array([-40.0, 70.0, 3.0]))
    return [(rng.uniform(-0.5, 0.5, (points, 3)).astype(np.float32), poses[i]) for i in range(count)]


def map_of(sweeps, slots=1 << 12):
    builder = PointMapBuilder(VOXEL_M, slots)
    for points, pose in sweeps:
        builder.insert(points, pose, SENSOR_EGO)
    return builder.finish()


def assert_same_bits(a, b):
    assert a.keys.tobytes() == b.keys.tobytes()
    assert a.moments.tobytes() == b.moments.tobytes()


@settings(max_examples=5, deadline=None)
@given(SEEDS)
def test_each_voxel_holds_what_a_dict_of_lists_holds(seed):
    sweeps = sweeps_of(seed)
    points, views, frames = defaultdict(list), defaultdict(list), defaultdict(set)
    for frame, (points_ego, pose) in enumerate(sweeps):
        sensor = pose @ SENSOR_EGO
        for point in pose @ points_ego.astype(np.float64):
            voxel = tuple(math.floor(c / VOXEL_M) for c in point)
            points[voxel].append(point)
            views[voxel].append((sensor - point) / np.linalg.norm(sensor - point))
            frames[voxel].add(frame)
    made = map_of(sweeps)
    voxels = sorted(points)
    assert [tuple(row) for row in indices_of(made.keys).tolist()] == voxels
    assert made.counts().tolist() == [len(points[v]) for v in voxels]
    assert made.frames_seen().tolist() == [len(frames[v]) for v in voxels]
    np.testing.assert_allclose(made.centroids_map(), [np.mean(points[v], axis=0) for v in voxels], atol=2 * QUANTUM_M)
    np.testing.assert_allclose(made.views_map(), [np.mean(views[v], axis=0) for v in voxels], atol=2 * QUANTUM_M)


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.permutations(range(5)))
def test_sweep_order_does_not_matter(seed, order):
    sweeps = sweeps_of(seed)
    assert_same_bits(map_of(sweeps), map_of([sweeps[i] for i in order]))


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.integers(1, 4), st.booleans())
def test_parts_add_up_to_the_whole(seed, cut, is_swapped):
    sweeps = sweeps_of(seed)
    parts = [map_of(sweeps[:cut]), map_of(sweeps[cut:])]
    assert_same_bits(merge(parts[::-1] if is_swapped else parts), map_of(sweeps))


@pytest.mark.whole
def test_a_table_that_grew_in_mid_sweep_holds_the_same_bits():
    sweeps = sweeps_of(3)
    assert len(map_of(sweeps)) > 16
    assert_same_bits(map_of(sweeps, slots=16), map_of(sweeps))


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 700))
def test_the_bits_are_those_of_points_added_one_by_one(seed, count):
    """Rounded point by point, half to even: whatever is added at once, no bit depends on it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 4, (count, 3)).astype(np.float32)
    pose = SE3.from_parts(rng.normal(size=4), rng.uniform(-30, 30, 3))
    matrix, sensor = pose.as_matrix(), pose @ SENSOR_EGO
    rows = defaultdict(lambda: [0] * 8)
    for point in points.astype(np.float64).tolist():
        at = [
            matrix[r, 0] * point[0] + matrix[r, 1] * point[1] + matrix[r, 2] * point[2] + matrix[r, 3]
            for r in (0, 1, 2)
        ]
        voxel = tuple(math.floor(c * (1.0 / VOXEL_M)) for c in at)
        view = [s - c for s, c in zip(sensor.tolist(), at, strict=True)]
        scale = 2.0**20 / math.sqrt(view[0] ** 2 + view[1] ** 2 + view[2] ** 2 + 1e-12)
        offsets = [round((c - (i + 0.5) * VOXEL_M) * 2.0**20) for c, i in zip(at, voxel, strict=True)]
        added = [1, 0, *offsets, *(round(v * scale) for v in view)]
        rows[voxel] = [a + b for a, b in zip(rows[voxel], added, strict=True)]
        rows[voxel][1] = 1
    made = map_of([(points, pose)], slots=1 << 14)
    assert [tuple(row) for row in indices_of(made.keys).tolist()] == sorted(rows)
    assert made.moments.tolist() == [rows[voxel] for voxel in sorted(rows)]


@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_only_points_in_reach_are_added(seed):
    reach = Box((-0.25, -0.5, -0.125), (0.25, 0.375, 0.5))
    rng = np.random.default_rng(seed)
    points = (rng.integers(-4, 5, (900, 3)) / 8).astype(np.float32)  # many lie just on a side
    inside = points[((points >= reach.min_m) & (points < reach.max_m)).all(axis=1)]
    pose = sweeps_of(seed)[0][1]
    builder = PointMapBuilder(VOXEL_M, 16)
    builder.insert(points, pose, SENSOR_EGO, reach)
    assert builder.points == len(inside)
    assert_same_bits(builder.finish(), map_of([(inside, pose)]))


@pytest.mark.parametrize(("limit", "value"), [("MOST_FRAMES", 2), ("MOST_POINTS", 700)])
def test_a_table_whose_tallies_are_full_is_followed_by_another(monkeypatch, limit, value):
    whole = map_of(sweeps_of(6))
    monkeypatch.setattr(f"stone.surface.pointmap.{limit}", value)
    assert_same_bits(map_of(sweeps_of(6)), whole)


def test_tallies_count_until_their_last_bit():
    rows, pose, reach = pointmap.free_rows(4096), SE3.identity(), np.array([[-1.0] * 3, [1.0] * 3])
    point = np.zeros((1, 3), np.float32)
    state = np.array([0, 0, 0, 2000])
    view = (reach, pose.as_matrix(), SENSOR_EGO, VOXEL_M)
    for frame in (0, 2**15 - 1, 2**15, pointmap.MOST_FRAMES - 1):
        pointmap.add_points(point, (*view, frame), rows, state, pointmap.workspace())
        state[0] = 0
    used = np.flatnonzero(rows[:, 0])
    rows[used, 1] += (pointmap.MOST_FRAMES - 4 << pointmap.POINT_BITS) + pointmap.MOST_POINTS - 4
    unpacked = np.empty((1, 8), np.int64)
    pointmap.unpack_rows(rows, used, unpacked)
    assert unpacked[0, :2].tolist() == [pointmap.MOST_POINTS, pointmap.MOST_FRAMES]


def test_two_passes_of_one_place_meet_in_the_same_voxels():
    """Driven again the other way, a minute later: the ground of both passes is one surface, not two."""
    ground = np.random.default_rng(7).uniform((-1, -1, 0.5137), (11, 5, 0.5137), (40_000, 3))
    there = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([4.0, 2.0, 0.5]))
    back = SE3.from_parts(np.array([0, 0, 0, 1.0]), np.array([6.5, 2.0, 0.5]))
    passes = [((pose.inverse() @ ground).astype(np.float32), pose) for pose in (there, back)]
    apart = [map_of([one]) for one in passes]
    joined = merge(apart)
    assert set(joined.keys) == set(keys_of(ground, VOXEL_M))
    assert len(joined) == len(apart[0]) == len(apart[1])
    assert (joined.frames_seen() == 2).all()
    np.testing.assert_allclose(joined.centroids_map()[:, 2], 0.5137, atol=4e-6)


def test_only_voxels_seen_in_enough_frames_are_kept():
    made = map_of(sweeps_of(5))
    kept = made.where_seen(3)
    assert 0 < len(kept) < len(made)
    assert kept.keys.tolist() == made.keys[made.frames_seen() >= 3].tolist()


def test_nothing_inserted_is_an_empty_map():
    empty = PointMapBuilder(VOXEL_M, 16).finish()
    assert len(empty) == 0
    assert len(merge([empty, empty])) == 0
    assert empty.centroids_map().shape == (0, 3)


@pytest.mark.parametrize(
    "broken", [[1, 0, 0, 0, math.nan, 0, 0], [math.nan, 0, 0, 0, 1, 2, 3], [1, 0, 0, 0, 4.2e6, 0, 0]]
)
def test_a_broken_pose_is_refused(broken):
    builder = PointMapBuilder(VOXEL_M, 16)
    with refused_as("off_lattice"):
        builder.insert(np.ones((1, 3), np.float32), SE3(np.array(broken, np.float64)), SENSOR_EGO)
    assert len(builder.finish()) == 0
