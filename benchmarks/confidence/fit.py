"""Fit the curves of `stone.labels.confidence`: a logistic regression on hinges, by Newton's method.

**Conventions.** Every drive weighs as much as any other. Of voxels that are clear (far within all limits, or far beyond
one) a part is taken that stands for all of them.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.confidence.voxels import Array, JudgedVoxels
from stone.labels.confidence import hinges
from stone.labels.confidence_curves import CURVES

RIDGE, STEPS, LONGEST_STEP = 1.0, 60, 5.0
CLEAR_RATIOS, CLEAR_SHARE = (0.5, 8.0), 0.05


def fitted(drives: Sequence[JudgedVoxels]) -> str:
    """Return the curves fitted to these drives, as they stand in `stone/labels/confidence_curves.py`."""
    designs, truths, weights = [], [], []
    for drive in drives:
        kept, weight = _thinned(drive)
        columns = dict(zip(drive.names, drive.properties[kept].T, strict=True))
        designs.append(
            np.hstack([hinges(columns[name], np.array(c.knots), c.end) for name, c in CURVES.curves.items()])
        )
        truths.append(drive.is_drivable[kept].astype(np.float64))
        weights.append(weight / weight.sum())
    design = np.vstack(designs)
    scale = np.where(design.any(axis=0), np.abs(design).max(axis=0), 1.0)  # a hinge that no voxel reaches stays 0
    found = _regressed(
        np.hstack([np.ones((len(design), 1)), design / scale]), np.concatenate(truths), np.concatenate(weights)
    )
    return _as_source(found[0], found[1:] / scale)


def _thinned(drive: JudgedVoxels) -> tuple[NDArray[np.int64], Array]:
    """Return which voxels of a drive are taken, and their weights."""
    ratio = drive.properties[:, drive.names.index("distance_ratio")]
    is_clear = (ratio < CLEAR_RATIOS[0]) | (ratio > CLEAR_RATIOS[1])
    taken = np.flatnonzero(~is_clear | (np.random.default_rng(0).random(len(ratio)) < CLEAR_SHARE))
    return taken, np.asarray(np.where(is_clear, drive.weight / CLEAR_SHARE, drive.weight)[taken])


def _regressed(design: Array, truth: Array, weight: Array) -> Array:
    weight = weight / weight.mean()
    ridge = np.full(design.shape[1], RIDGE)
    ridge[0] = 0.0
    found = np.zeros(design.shape[1])
    for _ in range(STEPS):
        probability = 1.0 / (1.0 + np.exp(-np.clip(design @ found, -30.0, 30.0)))
        curvature = weight * probability * (1.0 - probability) + 1e-9
        slope = design.T @ (weight * (truth - probability)) - ridge * found
        step = np.linalg.solve((design * curvature[:, None]).T @ design + np.diag(ridge), slope)
        found = found + step * min(1.0, LONGEST_STEP / np.abs(step).max())
        if np.abs(step).max() < 1e-4:
            break
    return found


def _as_source(intercept: float, weights: Array) -> str:
    lines, at = [f"    intercept={intercept:.4g},", "    curves={"], 0
    for name, curve in CURVES.curves.items():
        own = ", ".join(f"{weight:.4g}" for weight in weights[at : at + len(curve.knots)])
        lines.append(f"        {name!r}: Curve({curve.knots}, {curve.end}, ({own})),".replace("'", '"'))
        at += len(curve.knots)
    return "\n".join(["CURVES = Curves(", *lines, "    },", ")"])
