"""Fit of the curves of `stone.labels.confidence`: a logistic regression on hinges, by Newton's method.

**Conventions.** Every drive has the same weight. A sample represents all clear voxels (far within all limits, or far
beyond one).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.confidence.voxels import Array, JudgedVoxels
from stone.labels.confidence import drivable_log_odds, hinges
from stone.labels.confidence_curves import CURVES, Curve, Curves

RIDGE, STEPS, LONGEST_STEP = 1.0, 60, 5.0
CLEAR_RATIOS, CLEAR_SHARE = (0.5, 8.0), 0.05


def fitted(drives: Sequence[JudgedVoxels]) -> Curves:
    """Return the curves fitted to these drives: first the curves of the properties, then of P and N on top."""
    designs, truths, weights = [], [], []
    for drive in drives:
        kept, weight = _thinned(drive)
        columns = dict(zip(drive.names, drive.properties[kept].T, strict=True))
        designs.append(np.hstack([hinges(columns[name], curve) for name, curve in CURVES.properties.items()]))
        truths.append(drive.is_drivable[kept].astype(np.float64))
        weights.append(weight / weight.sum())
    coefficients = _regressed(np.vstack(designs), np.concatenate(truths), np.concatenate(weights))
    properties, at = {}, 1
    for name, curve in CURVES.properties.items():
        properties[name] = replace(curve, weights=_rounded(coefficients[at : at + len(curve.knots)]))
        at += len(curve.knots)
    curves = replace(CURVES, intercept=_rounded(coefficients[:1])[0], properties=properties)
    return replace(curves, p_right=_side(drives, curves, is_n=False), n_right=_side(drives, curves, is_n=True))


def _side(drives: Sequence[JudgedVoxels], curves: Curves, is_n: bool) -> Curve:
    """Return the curve from log odds of labels P, or N, to the true log odds."""
    odds, truths, weights = [], [], []
    for drive in drives:
        of_side = drive.is_kept != is_n
        log_odds = drivable_log_odds(dict(zip(drive.names, drive.properties[of_side].T, strict=True)), curves)
        odds.append(-log_odds if is_n else log_odds)
        truths.append((drive.is_drivable[of_side] != is_n).astype(np.float64))
        weights.append(drive.weight[of_side] / drive.weight.sum())
    curve = curves.n_right if is_n else curves.p_right
    coefficients = _regressed(hinges(np.concatenate(odds), curve), np.concatenate(truths), np.concatenate(weights))
    return replace(curve, weights=_rounded(coefficients[1:]), start=_rounded(coefficients[:1])[0])


def _thinned(drive: JudgedVoxels) -> tuple[NDArray[np.int64], Array]:
    """Return the sampled voxels of a drive, and their weights."""
    ratio = drive.properties[:, drive.names.index("distance_ratio")]
    is_clear = (ratio < CLEAR_RATIOS[0]) | (ratio > CLEAR_RATIOS[1])
    taken = np.flatnonzero(~is_clear | (np.random.default_rng(0).random(len(ratio)) < CLEAR_SHARE))
    return taken, np.asarray(np.where(is_clear, drive.weight / CLEAR_SHARE, drive.weight)[taken])


def _regressed(hinged: Array, truth: Array, weight: Array) -> Array:
    """Return the intercept and the weights (1 + n,) of the hinges (K, n) in the log odds of the truth (K,)."""
    # A hinge that no voxel reaches stays 0.
    scale = np.append(1.0, np.where(hinged.any(axis=0), np.abs(hinged).max(axis=0), 1.0))
    design = np.hstack([np.ones((len(hinged), 1)), hinged]) / scale
    weight = weight / weight.mean()
    ridge = np.full(design.shape[1], RIDGE)
    ridge[0] = 0.0
    coefficients = np.zeros(design.shape[1])
    for _ in range(STEPS):
        probability = 1.0 / (1.0 + np.exp(-np.clip(design @ coefficients, -30.0, 30.0)))
        curvature = weight * probability * (1.0 - probability) + 1e-9
        slope = design.T @ (weight * (truth - probability)) - ridge * coefficients
        step = np.linalg.solve((design * curvature[:, None]).T @ design + np.diag(ridge), slope)
        coefficients = coefficients + step * min(1.0, LONGEST_STEP / np.abs(step).max())
        if np.abs(step).max() < 1e-4:
            break
    return np.asarray(coefficients / scale)


def _rounded(weights: Array) -> tuple[float, ...]:
    return tuple(float(f"{weight:.4g}") for weight in weights.tolist())


def as_source(curves: Curves) -> str:
    """Return the curves as source text for `stone/labels/confidence_curves.py`."""
    properties = "".join(f'        "{name}": {curve},\n' for name, curve in curves.properties.items())
    sides = f"    p_right={curves.p_right},\n    n_right={curves.n_right},\n"
    return f"CURVES = Curves(\n    intercept={curves.intercept},\n    properties={{\n{properties}    }},\n{sides})"
