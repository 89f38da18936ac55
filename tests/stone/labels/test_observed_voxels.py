"""Rays against dense sampling and exact numbers: every voxel on the way is marked, and none off it."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from stone.geometry.lattice import centres_of, indices_of
from stone.geometry.se3 import SE3
from stone.labels.observed_voxels import (
    AXIS_BITS,
    BLOCK,
    CELLS,
    END,
    LANES,
    TIMES,
    CarveParameters,
    Carver,
    axis_mask,
    follow,
    share_of,
    step_of,
    union,
)
from stone.labels.voxels import VOXEL_M
from testing.refusals import refused_as
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


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.integers(1, 40))
def test_rays_mark_just_the_voxels_that_exact_numbers_walk_through(seed, count):
    """Every voxel on the way from end to end, and none off it."""
    points = rays(seed, count, reach_m=25.0)
    sensor, ends = POSE @ SENSOR_EGO / VOXEL_M, POSE @ points.astype(np.float64) / VOXEL_M
    expected = {voxel for end in ends.tolist() for voxel in walked(sensor.tolist(), end)}
    assert {tuple(row) for row in indices_of(voxel_keys(carved(points))).tolist()} == expected


@pytest.mark.parametrize("pose", [[1, 0, 0, 0, math.nan, 0, 0], [1, 0, 0, 0, 1e7, 0, 0]])
def test_a_broken_pose_is_refused(pose):
    carver = Carver(CarveParameters())
    with refused_as("off_lattice"):
        carver.carve(rays(1), SE3(np.array(pose, np.float64)), SENSOR_EGO)


def test_sweep_after_sweep_joins_what_each_observes():
    poses = [SE3.from_parts(np.array([1.0, 0, 0, 0.1 * i]), np.array([9.0 * i, -4.0 * i, i])) for i in range(4)]
    carver = Carver(CarveParameters(), slots=16)
    for i, pose in enumerate(poses):
        carver.carve(rays(i), pose, SENSOR_EGO)
    joined = union([carved(rays(i), pose=pose) for i, pose in enumerate(poses)])
    assert carver.finish().keys.tolist() == joined.keys.tolist()
    assert carver.finish().words.tolist() == joined.words.tolist()


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
    with pytest.raises(ValueError, match="the longest ray is 101 m, beyond the reach of a window"):
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


def test_of_sparse_sweeps_more_are_followed_and_of_dense_ones_as_many_as_asked_for():
    usual = CarveParameters()
    rays = [0, 1, 10_000, 39_999, 40_000, 57_600, 79_999, 80_000, 100_000, 230_400, 10**7]
    assert [usual.every(count) for count in rays] == [1, 1, 1, 1, 2, 2, 3, 4, 5, 5, 5]
    assert [CarveParameters(every_frame=2).every(count) for count in rays[3:]] == [1] + [2] * 7
    assert CarveParameters(every_frame=50).every(10**7) == 50


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


@pytest.mark.whole
def test_thinning_loses_nothing_where_rays_are_dense():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 0.2)), np.radians(np.arange(-12, 12, 0.2)))
    direction = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    points = (SENSOR_EGO + 20 * direction).astype(np.float32)
    assert len(points) > CarveParameters().sparse_rays
    whole = voxel_keys(carved(points, CarveParameters(sparse_rays=len(points)), pose=SE3.identity()))
    thinned = voxel_keys(carved(points, pose=SE3.identity()))
    assert np.isin(whole, thinned).mean() > 0.97


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


@njit
def followed(times, cells, bits, places):
    masks = axis_mask(bits, 0), axis_mask(bits, 1), axis_mask(bits, 2)
    return follow(times, cells, 0, masks, places)


@pytest.mark.parametrize("bits", [1, 5, 8])
def test_axes_share_out_all_bits_of_a_place(bits):
    masks = [axis_mask(bits, axis) for axis in range(3)]
    assert sum(masks) == masks[0] | masks[1] | masks[2] == 2 ** (3 * bits + 6) - 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_step_leads_to_the_next_share_and_around_the_window(axis):
    bits, voxels = 3, 4 * 2**3
    mask = axis_mask(bits, axis)
    for index in range(voxels):
        share = share_of(index, bits, axis)
        assert (share + step_of(1.0, bits, axis)) & mask == share_of((index + 1) % voxels, bits, axis)
        assert (share + step_of(-1.0, bits, axis)) & mask == share_of((index - 1) % voxels, bits, axis)


@pytest.mark.parametrize("steps", [1, 3, 40])
def test_no_more_is_written_than_there_is_room_for(steps):
    times, cells = np.zeros((TIMES, LANES), np.int64), np.zeros((CELLS, LANES), np.int32)
    times[:3] = np.arange(3)[:, None]  # one crossing after another, along x first
    times[3:6] = 3 << AXIS_BITS
    times[END], cells[3:] = np.iinfo(np.int64).max, 1
    places = np.full((steps + 1) * LANES - 1, -1, np.int32)
    assert followed(times, cells, 2, places) == steps * LANES
    assert (places[: steps * LANES] >= 0).all()
    assert (places[steps * LANES :] == -1).all()
