"""Rays against dense sampling: every voxel on the way is marked, and none off it."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import OffLatticeError, centres_of, indices_of, keys_from_indices, keys_of
from stone.geometry.se3 import SE3
from stone.labels.observed_voxels import BLOCK, BRICK, CarveParameters, Carver, Observed, union
from stone.labels.voxels import VOXEL_M
from tests.observed_voxels import voxel_keys

SENSOR_EGO = np.array([0.3, -0.1, 1.2])
POSE = SE3.from_parts(np.array([0.9, 0.1, -0.2, 0.3]), np.array([-13.0, 21.0, 4.0]))
SEEDS = st.integers(0, 2**32)


def rays(seed, count=60, reach_m=10.0):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return (SENSOR_EGO + direction * rng.uniform(0.01, reach_m, (count, 1))).astype(np.float32)


def carved(points, parameters=CarveParameters(), slots=1 << 16, pose=POSE):  # noqa: B008
    carver = Carver(parameters, slots)
    carver.carve(points, pose, SENSOR_EGO)
    return carver.finish()


def keys_off_borders(points_map):
    """Keys of the samples that are clearly inside a voxel, where rounding cannot matter."""
    depth = np.abs(points_map / VOXEL_M - np.round(points_map / VOXEL_M)).min(axis=1)
    return np.unique(keys_of(points_map[depth > 1e-6], VOXEL_M))


@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_every_voxel_on_the_way_of_a_ray_is_marked(seed):
    points = rays(seed)
    marked = voxel_keys(carved(points))
    sensor, ends = POSE @ SENSOR_EGO, POSE @ points.astype(np.float64)
    for end in ends:
        samples = sensor + np.linspace(0, 1, 3000)[:, None] * (end - sensor)
        assert np.isin(keys_off_borders(samples), marked).all()


@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_nothing_is_marked_off_the_rays(seed):
    points = rays(seed, count=12)
    centres = centres_of(voxel_keys(carved(points)), VOXEL_M)
    sensor = POSE @ SENSOR_EGO
    way = POSE @ points.astype(np.float64) - sensor
    along = np.einsum("vc,rc->vr", centres - sensor, way) / (way**2).sum(axis=1)
    nearest = sensor + np.clip(along, 0, 1)[..., None] * way
    off_m = np.linalg.norm(centres[:, None] - nearest, axis=2).min(axis=1)
    assert off_m.max() <= VOXEL_M * np.sqrt(3) / 2 + 1e-6


def walked(start, end):
    """The voxels a segment passes, one after the other: always over the face that it meets first (in exact numbers)."""
    start, end = [Fraction(c) for c in start], [Fraction(c) for c in end]
    voxel, last = [math.floor(c) for c in start], [math.floor(c) for c in end]
    way = [b - a for a, b in zip(start, end, strict=True)]
    passed = [tuple(voxel)]
    while voxel != last:
        faces = [(v + (w > 0) - s) / w if w else Fraction(9) for v, w, s in zip(voxel, way, start, strict=True)]
        axis = faces.index(min(faces))
        voxel[axis] += 1 if way[axis] > 0 else -1
        passed.append(tuple(voxel))
    return passed


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_each_ray_marks_just_the_voxels_that_exact_numbers_walk_through(seed):
    points = rays(seed, count=8, reach_m=25.0)
    sensor, ends = POSE @ SENSOR_EGO / VOXEL_M, POSE @ points.astype(np.float64) / VOXEL_M
    expected = {voxel for end in ends.tolist() for voxel in walked(sensor.tolist(), end)}
    assert {tuple(row) for row in indices_of(voxel_keys(carved(points))).tolist()} == expected


@pytest.mark.parametrize("pose", [[1, 0, 0, 0, math.nan, 0, 0], [1, 0, 0, 0, 1e7, 0, 0]])
def test_a_broken_pose_is_refused(pose):
    carver = Carver(CarveParameters())
    with pytest.raises(OffLatticeError, match="is a pose broken or given in global"):
        carver.carve(rays(1), SE3(np.array(pose, np.float64)), SENSOR_EGO)


def test_sweep_after_sweep_joins_what_each_observes():
    poses = [SE3.from_parts(np.array([1.0, 0, 0, 0.1 * i]), np.array([9.0 * i, -4.0 * i, i])) for i in range(4)]
    carver = Carver(CarveParameters(), slots=16)
    for i, pose in enumerate(poses):
        carver.carve(rays(i), pose, SENSOR_EGO)
    joined = union([carved(rays(i), pose=pose) for i, pose in enumerate(poses)])
    assert carver.finish().keys.tolist() == joined.keys.tolist()
    assert carver.finish().words.tolist() == joined.words.tolist()


def test_both_ends_of_a_ray_are_marked():
    points = rays(3, count=200)
    ends = np.concatenate([POSE @ points.astype(np.float64), [POSE @ SENSOR_EGO]])
    assert np.isin(keys_off_borders(ends), voxel_keys(carved(points))).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_ray_along_an_axis_marks_one_row(axis, sign):
    sensor, pose = np.array([0.1, 0.1, 0.1]), SE3.identity()
    point = sensor.copy()
    point[axis] += sign * 2.0
    carver = Carver(CarveParameters())
    carver.carve(point[None].astype(np.float32), pose, sensor)
    row = indices_of(voxel_keys(carver.finish()))
    assert sorted(sign * row[:, axis]) == list(range(11))
    assert (np.delete(row, axis, axis=1) == 0).all()


def test_rays_end_at_the_maximum_range():
    far = (SENSOR_EGO + np.array([[30.0, 0, 0]])).astype(np.float32)
    near = (SENSOR_EGO + np.array([[6.0, 0, 0]])).astype(np.float32)
    assert (voxel_keys(carved(far, CarveParameters(max_range_m=6.0))) == voxel_keys(carved(near))).all()


def test_a_larger_window_observes_the_same():
    points = rays(6, count=3 * BLOCK // 2, reach_m=30.0)
    usual, larger = carved(points), carved(points, CarveParameters(max_range_m=60.0))
    assert (usual.keys == larger.keys).all()
    assert (usual.words == larger.words).all()


def test_a_range_beyond_the_largest_window_is_refused():
    assert len(carved(rays(1), CarveParameters(max_range_m=100.0)).keys)
    with pytest.raises(ValueError, match="followed for 101 m, farther than a window reaches"):
        Carver(CarveParameters(max_range_m=101.0))


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.integers(1, 59))
def test_what_parts_observe_together_is_what_the_whole_observes(seed, cut):
    points = rays(seed)
    whole, joined = carved(points), union([carved(points[cut:]), carved(points[:cut])])
    assert (joined.keys == whole.keys).all()
    assert (joined.words == whole.words).all()


def test_a_table_that_grew_observes_the_same():
    points = rays(9, count=300)
    grown, roomy = carved(points, slots=16), carved(points)
    assert (grown.keys == roomy.keys).all()
    assert (grown.words == roomy.words).all()


def test_thinning_only_touches_dense_sweeps():
    points = rays(4, count=400)
    sparse = CarveParameters(thin_m=4.0, sparse_rays=400)
    dense = CarveParameters(thin_m=4.0, sparse_rays=399)
    whole = voxel_keys(carved(points, CarveParameters(thin_m=0.0)))
    assert (voxel_keys(carved(points, sparse)) == whole).all()
    thinned = voxel_keys(carved(points, dense))
    assert np.isin(thinned, whole).all()
    assert len(thinned) < 0.8 * len(whole)


def test_thinning_leaves_what_lies_beyond_three_times_its_range():
    points = rays(5, count=400, reach_m=12.0)
    whole = voxel_keys(carved(points, CarveParameters(thin_m=0.0)))
    thinned = voxel_keys(carved(points, CarveParameters(thin_m=2.0, sparse_rays=0)))
    beyond = np.linalg.norm(centres_of(whole, VOXEL_M) - POSE @ SENSOR_EGO, axis=1) > 6.0 + VOXEL_M
    assert beyond.any()
    assert np.isin(whole[beyond], thinned).all()


def test_thinning_loses_nothing_where_rays_are_dense():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 0.2)), np.radians(np.arange(-12, 12, 0.2)))
    direction = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    points = (SENSOR_EGO + 20 * direction).astype(np.float32)
    assert len(points) > CarveParameters().sparse_rays
    whole = voxel_keys(carved(points, CarveParameters(sparse_rays=len(points)), pose=SE3.identity()))
    thinned = voxel_keys(carved(points, pose=SE3.identity()))
    assert np.isin(whole, thinned).mean() > 0.97


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-40, 40)] * 3), min_size=1, max_size=60, unique=True))
def test_words_and_voxel_keys_say_the_same(voxels):
    words = {}
    for x, y, z in voxels:
        bit = ((x % BRICK) * BRICK + y % BRICK) * BRICK + z % BRICK
        brick = (x // BRICK, y // BRICK, z // BRICK)
        words[brick] = words.get(brick, 0) | 1 << bit
    bricks = sorted(words)
    observed = Observed(keys_from_indices(np.array(bricks)), np.array([words[b] for b in bricks], np.uint64))
    assert sorted(voxel_keys(observed).tolist()) == sorted(keys_from_indices(np.array(voxels)).tolist())


def test_nothing_followed_observes_nothing():
    empty = Carver(CarveParameters()).finish()
    assert len(voxel_keys(empty)) == 0
    assert len(union([empty, empty]).keys) == 0


ELSEWHERE = SE3.from_parts(np.array([1.0, 0.02, 0.03, 0.1]), np.array([300.0, -200.0, 10.0]))


@pytest.mark.parametrize("place", [(np.inf, 3e22, 6.5), (np.inf, -np.inf, np.inf), (np.nan, 0, 0), (3e38, -3e38, 5.0)])
@pytest.mark.parametrize("pose", [POSE, ELSEWHERE])
def test_a_ray_that_leads_nowhere_marks_nothing(pose, place):
    """Far from the map's origin it wrote outside of the window, and the process was killed."""
    hostile = np.tile(np.array(place, np.float32), (64, 1))
    assert len(carved(hostile, pose=pose).keys) == 0
    both = carved(np.concatenate([rays(3), hostile]), pose=pose)
    assert voxel_keys(both).tolist() == voxel_keys(carved(rays(3), pose=pose)).tolist()
