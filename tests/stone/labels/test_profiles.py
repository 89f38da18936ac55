"""Profiles against plain definitions: the shape around a voxel by loops, one-sided D² by search, the held-out way."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from stone.geometry.lattice import indices_of, keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.footprint import passes
from stone.labels.ground_shape import ground_shape
from stone.labels.held_out import DrivenPlaces, held_out
from stone.labels.profiles import RULES, distances, exceedance_squared, terrain_of
from stone.labels.traversability import Reference, ReferenceParameters, classify, reference_of_parts, threshold
from stone.labels.voxels import VOXEL_M, VoxelFeatures
from stone.sensors.calibration import Footprint, Vehicle

SEEDS = st.integers(0, 2**32 - 1)
LIMIT = threshold(0.05)


def voxels_at(indices, elevations=None, vertices=None):
    """Voxels in the order of their keys; their slope and roughness tell them apart."""
    keys = keys_from_indices(np.asarray(indices, np.int64))
    order = np.argsort(keys)
    z = (np.asarray(indices)[:, 2] + 0.5) * VOXEL_M if elevations is None else np.asarray(elevations, float)
    rows = np.arange(len(keys), dtype=float)
    counts = np.ones(len(keys), np.int64) if vertices is None else np.asarray(vertices)
    return VoxelFeatures(keys[order], np.column_stack([z, rows, -rows])[order], counts[order])


def shape_slowly(voxels, tangent, body_m):
    """Slope, step, clearance and pooled features of each voxel, by the definitions and `lstsq`."""
    cells = dict(zip(map(tuple, indices_of(voxels.keys).tolist()), range(len(voxels)), strict=True))
    found = []
    for (i, j, k), row in cells.items():
        own, plane, step_m, near, above = voxels.features[row], [], 0.0, [], [math.inf]
        for (a, b, c), other in cells.items():
            rise_m, away_m = voxels.features[other, 0] - own[0], VOXEL_M * math.hypot(a - i, b - j)
            if away_m <= 0.5 and abs(c - k) <= 3:
                plane.append(((a - i) * VOXEL_M, (b - j) * VOXEL_M, rise_m))
                if max(abs(a - i), abs(b - j)) <= 1:
                    step_m = max(step_m, abs(rise_m) - tangent * away_m)
            if max(abs(a - i), abs(b - j), abs(c - k)) <= 1:
                near.append(other)
            if (a, b) == (i, j) and c > k and rise_m > body_m:
                above.append(rise_m)
        x, y, z = np.array(plane).T
        design = np.column_stack([x, y, np.ones_like(x)])
        slope = 0.0
        if len(plane) >= 4 and np.linalg.matrix_rank(design) == 3:
            along = np.linalg.lstsq(design, z, rcond=None)[0]
            slope = math.atan(math.hypot(along[0], along[1]))
        found.append((slope, step_m, min(above), *np.average(voxels.features[near], 0, voxels.vertices[near])))
    return np.array(found)


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_the_shape_is_that_of_plain_loops(seed):
    rng = np.random.default_rng(seed)
    indices = np.unique(rng.integers((-4, 90, -3), (5, 97, 6), (120, 3)), axis=0)
    elevations = (indices[:, 2] + rng.uniform(0, 1, len(indices))) * VOXEL_M
    voxels = voxels_at(indices, elevations, rng.integers(1, 5, len(indices)))
    made = ground_shape(voxels, math.radians(20), 0.3)
    slow = shape_slowly(voxels, math.tan(math.radians(20)), 0.3)
    np.testing.assert_allclose(made.slope_rad, slow[:, 0], atol=1e-7)
    np.testing.assert_allclose(made.step_m, slow[:, 1], atol=1e-12)
    np.testing.assert_array_equal(made.clearance_m, slow[:, 2])
    np.testing.assert_allclose(made.pooled, slow[:, 3:], atol=1e-12)


def test_no_voxels_and_voxels_in_a_line_have_no_slope():
    assert len(ground_shape(voxels_at(np.zeros((0, 3), np.int64)), 0.3, 0.3).slope_rad) == 0
    line = ground_shape(voxels_at([(i, 5, i) for i in range(6)]), 0.3, 0.3)
    np.testing.assert_array_equal(line.slope_rad, 0.0)
    np.testing.assert_array_equal(line.clearance_m, math.inf)


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_one_sided_d2_is_the_least_of_all_ground_that_is_no_better(seed):
    """By non-negative least squares over what is added to the features (Lawson and Hanson, 1974)."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(3, 3))
    reference = Reference(rng.normal(size=3), factor @ factor.T + 0.1 * np.eye(3), 99, is_floored=False)
    features, inverse = rng.normal(0, 3, (6, 3)), np.linalg.inv(reference.covariance)
    found = exceedance_squared(features, reference)
    root = np.linalg.cholesky(inverse).T
    for row, squared in zip(features, found, strict=True):
        _, distance = nnls(root, -root @ (row - reference.mean))
        assert squared == pytest.approx(distance**2, rel=1e-6, abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_one_sided_d2_never_falls_if_a_feature_rises(seed):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(3, 3))
    reference = Reference(np.zeros(3), factor @ factor.T + 0.1 * np.eye(3), 99, is_floored=False)
    features = rng.normal(0, 3, (50, 3))
    worse = exceedance_squared(features + rng.exponential(1, (50, 3)) * (rng.random((50, 3)) < 0.5), reference)
    assert (worse >= exceedance_squared(features, reference) * (1 - 1e-9)).all()
    assert (exceedance_squared(-np.abs(features), reference) == 0).all()


GENTLE = Reference(np.array([0.03, 0.05, -11.0]), np.diag([0.05, 0.07, 0.7]) ** 2, 999, is_floored=False)


def classes_in(profile, voxels, vehicle=Vehicle()):  # noqa: B008  frozen
    features = voxels.features * (1.0, 0.0, 0.0) + (0.0, 0.05, -11.0)
    plain = VoxelFeatures(voxels.keys, features, voxels.vertices)
    shape = ground_shape(plain, math.radians(vehicle.max_slope_deg), 0.3)
    terrain = terrain_of(plain, np.full(len(voxels), 0.03), shape, voxels.vertices)
    squared = distances(terrain, GENTLE, RULES[profile], (vehicle, LIMIT))
    return dict(zip(map(tuple, indices_of(voxels.keys).tolist()), classify(squared, squared < 0, 0.05), strict=True))


def plain_with(extra):
    flat = [(i, j, 0) for i in range(-6, 7) for j in range(-6, 7)]
    return voxels_at([*flat, *extra])


def test_ground_under_a_bar_is_blocked_and_under_a_crown_it_is_not():
    voxels = plain_with([(0, 0, 4), (4, 0, 14)])
    found = classes_in("field", voxels)
    assert (found[0, 0, 0], found[4, 0, 0]) == (3, 2)
    assert classes_in("local", voxels)[0, 0, 0] == 2
    low = classes_in("field", voxels, Vehicle(height_m=0.7))
    assert low[0, 0, 0] == 2


def test_a_step_blocks_both_of_its_sides_if_the_vehicle_cannot_climb_it():
    voxels = voxels_at([(i, j, 0 if i < 0 else 1) for i in range(-6, 6) for j in range(-6, 6)])
    assert [classes_in("field", voxels)[i, 0, int(i >= 0)] for i in (-4, -1, 0, 4)] == [2, 3, 3, 2]
    climber = Vehicle(max_step_m=0.3, max_slope_deg=45.0)
    assert classes_in("field", voxels, climber)[-1, 0, 0] == 2


@pytest.mark.parametrize(("slope_deg", "kind"), [(15.0, 2), (19.0, 2), (21.5, 3), (40.0, 3)])
def test_a_slope_beyond_the_vehicles_is_blocked_however_alike_the_ground_is(slope_deg, kind):
    plan = [(i, j) for i in range(-6, 7) for j in range(-6, 7)]
    z = [i * VOXEL_M * math.tan(math.radians(slope_deg)) for i, _ in plan]
    voxels = voxels_at([(i, j, math.floor(h / VOXEL_M)) for (i, j), h in zip(plan, z, strict=True)], z)
    assert classes_in("field", voxels)[0, 0, 0] == kind


def test_flatter_smoother_and_lower_ground_is_never_blocked_in_field():
    better = np.array([[-0.5, 0.0, -14.0], [0.03, 0.0, -20.0], [0.03, 0.05, -11.0]])
    assert (exceedance_squared(better, GENTLE) < 1e-9).all()


def test_a_few_wrong_voxels_do_not_widen_a_cleaned_reference():
    rng = np.random.default_rng(8)
    ground = rng.normal(size=(1000, 3)) * (0.02, 0.03, 0.8) + (0.02, 0.06, -11.0)
    grass = np.concatenate([ground, rng.normal(size=(80, 3)) * 0.1 + (0.25, 0.9, -7.0)])
    plain, cleaned = (
        reference_of_parts([grass], np.zeros(3), ReferenceParameters(clean_mads=mads)) for mads in (0.0, 3.5)
    )
    truth = np.cov(ground.T)
    assert plain.covariance[1, 1] > 20 * truth[1, 1]
    assert np.diag(cleaned.covariance) == pytest.approx(np.diag(truth), rel=0.1)
    assert (cleaned.voxels, plain.left_out) == (1080, 0)
    assert 80 <= cleaned.left_out < 95


def test_measurement_noise_is_added_however_long_the_way():
    rows = np.random.default_rng(3).normal(size=(5000, 3)) * (0.01, 0.01, 0.5)
    bare, noisy = (
        reference_of_parts([rows], np.zeros(3), ReferenceParameters(noise=noise))
        for noise in ((0.0, 0.0, 0.0), (0.05, 0.07, 0.7))
    )
    added = noisy.covariance - bare.covariance
    np.testing.assert_allclose(added, np.diag([0.05, 0.07, 0.7]) ** 2, atol=1e-12)


def test_passes_are_the_metres_at_which_a_voxel_first_and_last_lay_under_the_robot():
    """There and back along x: what lies at x m is passed x − 0.5 m along the way, and last 20 m later, the robot's half
    length on."""
    there = np.linspace(0, 10, 101)
    x = np.concatenate([there, there[::-1]])
    poses = np.zeros((len(x), 7))
    poses[:, 0], poses[:, 4] = 1.0, x
    keys = keys_from_indices(np.array([(25, 0, 0), (40, 0, 0), (25, 20, 0)]))
    made = passes(keys, (SE3(poses),), Footprint(1.0, 0.8), start_m=100.0)
    np.testing.assert_allclose(made.first_m[:2], [100 + 5.1 - 0.5, 100 + 8.1 - 0.5], atol=0.11)
    np.testing.assert_allclose(made.last_m[:2], [120 - 5.1 + 0.5, 120 - 8.1 + 0.5], atol=0.11)
    assert made.is_driven.tolist() == [True, True, False]


def test_held_out_voxels_are_counted_by_their_distance_from_the_known_way():
    known = DrivenPlaces(np.array([[0.0, 0.0], [1.0, 0.0]]), np.zeros(2, np.int64))
    x = np.array([2.0, 5.5, 7.0, 16.0, 300.0, 2.0])
    judged = DrivenPlaces(np.column_stack([x, np.zeros(6)]), np.array([0, 0, 0, 0, 0, 1]))
    found = held_out(known, judged, np.array([True, True, False, True, False, True]), 0.8)
    assert found.voxels.tolist() == [2, 1, 1, 2]
    assert found.kept.tolist() == [2, 0, 1, 1]
    assert found.recall == pytest.approx(4 / 6)
    assert found.judged_m == pytest.approx(6 * 0.04 / 0.8)
