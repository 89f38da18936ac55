"""Robust location and scatter: the minimum covariance determinant, which resists a few wrong voxels.

**Conventions.** The method searches the h of n rows with the smallest covariance determinant (Rousseeuw, 1985). It uses
concentration steps (Rousseeuw and Van Driessen, 1999) from deterministic starts (Hubert, Rousseeuw and Verdonck, 2012),
and reweights once. Scatter is scaled to be consistent for Gaussian rows.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.sensors.clocks import MAD_TO_SIGMA

MOST_STEPS = 100
RIDGE = 1e-9  # relative to the rows' spread: a constant feature has no variance to divide by
INLIER_RATIO = 0.975

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scatter:
    """`mean` (d,) and `covariance` (d, d) of the rows in `is_inlier` (n,)."""

    mean: Array
    covariance: Array
    is_inlier: NDArray[np.bool_]


def robust_scatter(rows: Array, outlier_ratio: float) -> Scatter:
    """Return the scatter of rows (n, d), n > d + 1, with up to the share `outlier_ratio` (0 to 0.5) of outliers."""
    count, width = rows.shape
    kept = max(math.ceil((1.0 - outlier_ratio) * count), width + 1)
    middle, spread = middle_and_spread(rows)
    scaled = (rows - middle) / spread
    ends = (_concentrated(scaled, start, kept) for start in _starts(scaled, kept))
    mean, covariance = min(ends, key=lambda moments: _log_volume(moments[1]))
    covariance = covariance * _consistency(kept / count, width)
    is_inlier = _squared(scaled, mean, covariance) <= _chi_squared(width, INLIER_RATIO)
    mean, covariance = _moments(scaled, np.flatnonzero(is_inlier))
    covariance = covariance * _consistency(INLIER_RATIO, width)
    return Scatter(mean * spread + middle, covariance * np.outer(spread, spread), is_inlier)


def _starts(scaled: Array, kept: int) -> Iterator[NDArray[np.int64]]:
    """Yield the rows (kept,) nearest the centre, with axes from the rows' signs and from their squashed values."""
    lengths = np.linalg.norm(scaled, axis=1, keepdims=True)
    signs = np.divide(scaled, lengths, out=np.zeros_like(scaled), where=lengths > 0)
    for shape in (np.eye(scaled.shape[1]), signs.T @ signs, np.cov(np.tanh(scaled).T)):
        along = scaled @ np.linalg.eigh(shape)[1]
        middle, spread = middle_and_spread(along)
        yield _least(np.square((along - middle) / spread).sum(axis=1), kept)


def _concentrated(scaled: Array, subset: NDArray[np.int64], kept: int) -> tuple[Array, Array]:
    """Return mean and covariance after concentration steps. Each step selects the `kept` nearest rows, until the
    determinant is constant.
    """
    moments = _moments(scaled, subset)
    for _ in range(MOST_STEPS):
        nearer = _moments(scaled, _least(_squared(scaled, *moments), kept))
        if not _log_volume(nearer[1]) < _log_volume(moments[1]):
            break
        moments = nearer
    return moments


def middle_and_spread(rows: Array) -> tuple[Array, Array]:
    """Return the median and the scaled median deviation (d,); the standard deviation if most rows are equal, 1 if all
    are.
    """
    middle = np.median(rows, axis=0)
    spread = MAD_TO_SIGMA * np.median(np.abs(rows - middle), axis=0)
    spread = np.where(spread > 0, spread, rows.std(axis=0))
    return middle, np.where(spread > 0, spread, 1.0)


def _moments(scaled: Array, subset: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return mean and unbiased covariance of the rows `subset`."""
    rows = scaled[subset]
    return rows.mean(axis=0), np.cov(rows.T)


def _squared(scaled: Array, mean: Array, covariance: Array) -> Array:
    """Return the squared Mahalanobis distance (n,) of all rows."""
    centred = scaled - mean
    inverse = np.linalg.inv(covariance + RIDGE * np.eye(len(mean)))
    return np.asarray(np.einsum("ni,ni->n", centred @ inverse, centred))


def _log_volume(covariance: Array) -> float:
    """Return the logarithm of the determinant."""
    return float(np.linalg.slogdet(covariance + RIDGE * np.eye(len(covariance)))[1])


def _least(values: Array, kept: int) -> NDArray[np.int64]:
    """Return the indices of the `kept` smallest values (n,), in row order."""
    return np.sort(np.argpartition(values, kept - 1)[:kept])


def _consistency(ratio: float, width: int) -> float:
    """Return the factor by which the covariance of a Gaussian's innermost `ratio` is too small (Croux and Haesbroeck,
    1999).
    """
    if ratio >= 1.0:
        return 1.0
    from scipy.special import chdtr  # a lazy import: it takes an eighth of a second

    return float(ratio / chdtr(width + 2, _chi_squared(width, ratio)))


def _chi_squared(width: int, ratio: float) -> float:
    """Return the squared distance that contains this share of a Gaussian."""
    from scipy.special import chdtri

    return float(chdtri(width, 1.0 - ratio))
