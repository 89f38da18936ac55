"""The confidence of a label: the sum of its curves, the side that a label takes, and the numbers in a file."""

import math

import numpy as np
import pytest

from stone.labels.confidence import confidence_of, drivable_log_odds, properties_of, right_probability
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


def by_hand(curve, value):
    """The curve at a value, hinge by hinge."""
    value = min(value, curve.end)
    return curve.start + sum(w * (value - at) for at, w in zip(curve.knots, curve.weights, strict=True) if value > at)


def test_the_log_odds_are_the_sum_of_the_curves_and_a_label_is_right_by_its_own_curve():
    rng = np.random.default_rng(3)
    properties = {name: rng.uniform(one.knots[0] - 1, one.end + 1, 40) for name, one in CURVES.properties.items()}
    found = drivable_log_odds(properties)
    for row in range(40):
        parts = [by_hand(one, properties[name][row]) for name, one in CURVES.properties.items()]
        assert found[row] == pytest.approx(CURVES.intercept + sum(parts))
    log_odds = np.linspace(-9, 9, 19)
    for is_n, curve in ((False, CURVES.p_right), (True, CURVES.n_right)):
        expected = [1 / (1 + math.exp(-by_hand(curve, -x if is_n else x))) for x in log_odds.tolist()]
        np.testing.assert_allclose(right_probability(log_odds, np.full(19, is_n)), expected, rtol=1e-9)
        assert np.ptp(expected) > 0.8


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


def test_what_makes_p_doubtful_makes_n_sure_and_what_was_driven_is_sure():
    rows = [(0.1, 0.3, -8.0, 0.3, 0.1, np.inf), (0.3, 0.6, -8.0, 0.5, 0.3, np.inf)]
    properties = properties_of(terrain(rows), np.array([1.0, 9.0]) * LIMITS[1], REFERENCE, LIMITS)
    p, n, t = (
        confidence_of(properties, np.full(2, one, np.uint8)) for one in (POTENTIAL, NON_TRAVERSABLE, TRAVERSABLE)
    )
    assert p.dtype == np.uint8
    assert p[0] > p[1]
    assert n[0] < n[1]
    assert t.tolist() == [255, 255]


def test_no_surface_has_the_confidence_0():
    hopeless = properties_of(terrain([(1.2, 1.2, -4.0, 0.6, 0.5, np.inf)]), np.array([400.0]), REFERENCE, LIMITS)
    assert confidence_of(hopeless, np.array([POTENTIAL], np.uint8))[0] >= 1
