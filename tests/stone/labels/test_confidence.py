"""The confidence of a label: the sum of its curves, the side that a label takes, and the numbers in a file."""

import math

import numpy as np
import pytest

from stone.labels.confidence import confidence_of, drivable_probability, properties_of
from stone.labels.confidence_curves import CURVES
from stone.labels.profiles import CLEARANCE, HEIGHT, POOLED, SLOPE, STEP, VoxelTerrain
from stone.labels.traversability import NON_TRAVERSABLE, POTENTIAL, TRAVERSABLE, Reference, threshold
from stone.sensors.calibration import Vehicle

LIMITS = (Vehicle(), threshold(0.05))
REFERENCE = Reference(np.array([0.05, 0.05, -9.0]), np.diag(np.square([0.06, 0.09, 1.2])), 900, is_floored=False)


def terrain(rows):
    """Voxels of these heights m, slopes rad, roughness log m², slope under a footprint rad, steps and clearance m."""
    columns = np.zeros((len(rows), 11))
    for row, (height, slope, roughness, under, step, clearance) in zip(columns, rows, strict=True):
        row[HEIGHT], row[POOLED], row[SLOPE] = height, (height, slope, roughness), under
        row[STEP], row[CLEARANCE] = step, clearance
    return VoxelTerrain(np.arange(len(rows)), columns)


def by_hand(properties, row):
    """The log odds of one voxel, hinge by hinge."""
    total = CURVES.intercept
    for name, curve in CURVES.curves.items():
        value = min(properties[name][row], curve.end)
        total += sum(w * (value - knot) for knot, w in zip(curve.knots, curve.weights, strict=True) if value > knot)
    return total


def test_the_log_odds_are_the_sum_of_the_curves():
    rng = np.random.default_rng(3)
    properties = {name: rng.uniform(curve.knots[0] - 1, curve.end + 1, 40) for name, curve in CURVES.curves.items()}
    expected = [1 / (1 + math.exp(-by_hand(properties, row))) for row in range(40)]
    np.testing.assert_allclose(drivable_probability(properties), expected, rtol=1e-9)
    assert np.ptp(expected) > 0.9


def test_properties_are_shares_of_the_vehicles_limits_and_sigmas_of_the_reference():
    found = properties_of(
        terrain([(0.11, 0.23, -7.8, np.deg2rad(10), 0.06, 3.2)]), np.array([LIMITS[1] * 4]), REFERENCE, LIMITS
    )
    expected = {
        "slope_ratio": 0.5,
        "step_ratio": 0.5,
        "clearance_ratio": 0.5,
        "height_sigmas": 1.0,
        "slope_sigmas": 2.0,
    }
    expected |= {"roughness_sigmas": 1.0, "distance_ratio": 2.0, "height_m": 0.11, "roughness_log_m2": -7.8}
    expected["pooled_slope_ratio"] = 0.23 / np.deg2rad(20)
    assert {name: values[0] for name, values in found.items()} == pytest.approx(expected)


def test_a_label_far_within_its_limits_is_nearly_sure_and_one_at_them_is_not():
    rows = [
        (0.0, 0.03, -9.5, 0.03, 0.0, np.inf),
        (1.2, 1.2, -4.0, 0.6, 0.5, np.inf),
        (0.1, 0.33, -8.0, 0.34, 0.1, np.inf),
    ]
    squared = np.array([0.2, 400.0, LIMITS[1]])
    properties = properties_of(terrain(rows), squared, REFERENCE, LIMITS)
    right = confidence_of(properties, np.array([POTENTIAL, NON_TRAVERSABLE, POTENTIAL], np.uint8)) / 255
    assert (right[:2] > 0.98).all()
    assert 0.1 < right[2] < 0.9


def test_p_and_n_are_two_sides_of_one_probability_and_what_was_driven_is_sure():
    properties = properties_of(
        terrain([(0.1, 0.3, -8.0, 0.3, 0.1, np.inf)] * 3), np.full(3, LIMITS[1]), REFERENCE, LIMITS
    )
    found = confidence_of(properties, np.array([POTENTIAL, NON_TRAVERSABLE, TRAVERSABLE], np.uint8))
    assert found.dtype == np.uint8
    assert found[0] + found[1] in (255, 256)
    assert found[2] == 255


def test_no_surface_has_the_confidence_0():
    hopeless = properties_of(terrain([(1.2, 1.2, -4.0, 0.6, 0.5, np.inf)]), np.array([400.0]), REFERENCE, LIMITS)
    assert confidence_of(hopeless, np.array([POTENTIAL], np.uint8))[0] >= 1
