"""Reliability against draws of known probability, and the fit against a curve that is known."""

from dataclasses import replace

import numpy as np

from benchmarks.confidence import fit
from benchmarks.confidence.reliability import reliability_of
from benchmarks.confidence.voxels import JudgedVoxels
from stone.labels.confidence import drivable_log_odds, right_probability
from stone.labels.confidence_curves import CURVES, Curve


def test_what_is_right_as_often_as_claimed_is_reliable_and_what_is_not_is_not():
    rng = np.random.default_rng(5)
    claimed, weight = rng.random(40_000), rng.integers(1, 5, 40_000).astype(float)
    sound = reliability_of(claimed, rng.random(40_000) < claimed, weight)
    assert sound.tenths < 0.03
    assert sound.bins < 0.03
    vain = reliability_of(claimed, rng.random(40_000) < claimed**2, weight)  # 0.25 apart in the middle
    assert 0.2 < vain.tenths < 0.28
    assert 0.2 < vain.bins < 0.28


def test_few_voxels_of_one_bin_say_nothing():
    claimed = np.concatenate([np.full(1000, 0.95), np.full(50, 0.15)])
    found = reliability_of(claimed, claimed > 0, np.ones(1050))
    assert found.bins < 0.1


def test_the_fit_finds_the_curves_that_truth_was_drawn_from():
    rng, names = np.random.default_rng(11), tuple(CURVES.properties)
    true = {name: replace(curve, weights=tuple(0.0 for _ in curve.knots)) for name, curve in CURVES.properties.items()}
    true["slope_ratio"] = Curve(CURVES.properties["slope_ratio"].knots, 5.0, (0.0, 0.0, 0.0, 0.0, -8.0, 0.0, 0.0))
    columns = np.column_stack([rng.uniform(curve.knots[0], curve.end, 60_000) for curve in true.values()])
    columns[:, names.index("distance_ratio")] = 1.0  # none is clear, so all are taken
    columns[:, names.index("slope_ratio")] = rng.uniform(0.5, 1.8, 60_000)
    probability = 1 / (1 + np.exp(-(3.0 - 8.0 * np.maximum(columns[:, names.index("slope_ratio")] - 1.0, 0))))
    is_kept = rng.random(60_000) < 0.7
    judged = JudgedVoxels(names, columns, rng.random(60_000) < probability, is_kept, np.ones(60_000))
    scope: dict[str, object] = {"Curve": Curve, "Curves": type(CURVES)}
    exec(fit.as_source(fit.fitted([judged])), scope)
    log_odds = drivable_log_odds(dict(zip(names, columns.T, strict=True)), scope["CURVES"])
    found = right_probability(log_odds, np.zeros(60_000, bool), scope["CURVES"])
    assert np.abs(found - probability).mean() < 0.01
