"""Confidence: the calibrated probability that the label of a voxel is right.

**Conventions.** The log odds that the vehicle can drive over a voxel are a sum of piecewise linear functions of its
properties (a generalised additive model; Hastie and Tibshirani, 1986). A further function, for P or for N, converts
them to the log odds that the label is right. `benchmarks.confidence` fits `CURVES` to simulated worlds, for profile
`field`. A voxel is drivable there if the ground is within the vehicle's limits and nothing stands on it. T is always
right, because the robot drove there. In files a confidence is a uint8: 255 times the probability, at least 1; 0 for
voxels without a surface.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stone.labels.confidence_curves import CURVES, Curve, Curves
from stone.labels.profiles import RULES, Profile, VoxelTerrain
from stone.labels.traversability import NON_TRAVERSABLE, TRAVERSABLE, Reference
from stone.sensors.calibration import Vehicle
from stone_base.confidence import CERTAIN

CALIBRATED: Profile = "field"
Array = NDArray[np.float64]


def properties_of(
    terrain: VoxelTerrain, squared: Array, reference: Reference, limits: tuple[Vehicle, float]
) -> Mapping[str, Array]:
    """Return the voxel properties (K,) that determine the confidence, by name.

    `squared` (K,) is their D², and `limits` are the vehicle and the threshold, as for
    `stone.labels.profiles.distances`. `…_sigmas` are standard deviations above the reference, `…_ratio` shares of a
    limit; the others are in m and log m².
    """
    vehicle, threshold = limits
    features = terrain.features(RULES[CALIBRATED])
    sigmas = (features - reference.mean) / np.sqrt(np.diag(reference.covariance))
    slope, step, clearance = terrain.limit_ratios(vehicle).T
    return {
        "slope_ratio": slope,
        "step_ratio": step,
        "clearance_ratio": clearance,
        "height_sigmas": sigmas[:, 0],
        "slope_sigmas": sigmas[:, 1],
        "roughness_sigmas": sigmas[:, 2],
        "distance_ratio": np.sqrt(squared / threshold),
        "pooled_slope_ratio": features[:, 1] / np.deg2rad(vehicle.max_slope_deg),
        "height_m": features[:, 0],
        "roughness_log_m2": features[:, 2],
    }


def hinges(values: Array, curve: Curve) -> Array:
    """Return how far values (K,) are beyond each of the curve's knots (n,), clipped at its end; (K, n)."""
    return np.asarray(np.maximum(np.minimum(values, curve.end)[:, None] - np.array(curve.knots), 0.0))


def drivable_log_odds(properties: Mapping[str, Array], curves: Curves = CURVES) -> Array:
    """Return the log odds (K,) that the vehicle can drive over voxels with these properties."""
    log_odds = np.full(len(properties["height_m"]), curves.intercept)
    for name, curve in curves.properties.items():
        log_odds += _on_curve(properties[name], curve)
    return log_odds


def right_probability(log_odds: Array, is_n: NDArray[np.bool_], curves: Curves = CURVES) -> Array:
    """Return the probability (K,) that the label N or P of each voxel is right, from its log odds (K,) of being
    drivable.
    """
    right = np.where(is_n, _on_curve(-log_odds, curves.n_right), _on_curve(log_odds, curves.p_right))
    return np.asarray(1.0 / (1.0 + np.exp(-right)))


def confidence_of(properties: Mapping[str, Array], classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the confidence (K,) uint8 of voxel labels with the classes (K,) 1 to 3."""
    right = right_probability(drivable_log_odds(properties), classes == NON_TRAVERSABLE)
    right[classes == TRAVERSABLE] = 1.0
    return np.asarray(np.clip(np.rint(right * CERTAIN), 1, CERTAIN), dtype=np.uint8)


def _on_curve(values: Array, curve: Curve) -> Array:
    return np.asarray(curve.start + hinges(values, curve) @ np.array(curve.weights))
