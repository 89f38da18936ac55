"""All pairs of a board at once: which entry surely does better than which.

    a is surely above b  where  (r_a − r_b) / √Var(r_a − r_b) > q(n, ν) / √2

with q the quantile of Tukey's studentised range of n entries. So that *any* two of n equally good entries are told
apart has the stated chance together, and the best of many lucky ones is not told apart from the last for its luck.

**Conventions.** Coefficients are rows, (n, K) of `spectra.py`, of one ratio; ratios (n,).

Source: Tukey (1953), Kramer (1956), for unequal variances Games and Howell (1976).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.intervals import LEAST_SPREAD, LEVEL, RatioSpectra
from stone.scoring.spectra import Coefficients, Floats, SpectrumLayout, sampling_variances

PAIRS_AT_ONCE = 4096
Claims = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class BoardSpectra:
    """Of n entries: coefficients (n, K) of the ranked ratio, and the share of frames (n,) that it is spread over."""

    layout: SpectrumLayout
    coefficients: Coefficients
    spread: Floats


def board_spectra(entries: Sequence[RatioSpectra], column: int) -> BoardSpectra:
    """Of scores by one ground truth, so of the same sequences, one or more: one of the ratios that each has."""
    return BoardSpectra(
        entries[0].layout,
        np.stack([one.coefficients[:, column] for one in entries]),
        np.array([one.spread[column] for one in entries], np.float64),
    )


def surely_above(values: NDArray[np.floating], spectra: BoardSpectra, level: float = LEVEL) -> Claims | None:
    """Whether entry a surely does better than b (n, n); None where of no pair anything can be said.

    Raises `ShapeError` where there are not as many values as entries.
    """
    count = len(spectra.coefficients)
    if values.shape != (count,):
        raise ShapeError("values", values.shape, f"({count},), one for each entry")
    above, is_any_known = np.zeros((count, count), np.bool_), False
    for first, second in _pairs(count):
        differences = spectra.coefficients[first].astype(np.float64) - spectra.coefficients[second]
        found = sampling_variances(differences, spectra.layout)
        is_known = found.is_known & (np.minimum(spectra.spread[first], spectra.spread[second]) >= LEAST_SPREAD)
        is_any_known |= bool(is_known.any())
        first, second = first[is_known], second[is_known]
        reach = np.sqrt(found.variance[is_known]) * _critical(count, found.degrees[is_known], level)
        margin = values[first] - values[second]
        above[first, second], above[second, first] = margin > reach, -margin > reach
    return above if is_any_known else None


def _pairs(count: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    first, second = np.triu_indices(count, 1)
    for start in range(0, len(first), PAIRS_AT_ONCE):
        yield first[start : start + PAIRS_AT_ONCE], second[start : start + PAIRS_AT_ONCE]


def _critical(count: int, degrees: Floats, level: float) -> Floats:
    """q / √2 for each pair; degrees are rounded down."""
    whole = np.floor(degrees).astype(np.int64)
    known = {one: range_quantile(count, one, level) / np.sqrt(2) for one in np.unique(whole).tolist()}
    return np.array([known[one] for one in whole.tolist()])


@lru_cache(4096)
def range_quantile(count: int, degrees: int, level: float = LEVEL) -> float:
    """The quantile of the studentised range of `count` ≥ 2 normal values, by bisection of its distribution."""
    low, high = 0.0, 64.0
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (low, middle) if _range_distribution(middle, count, degrees) > level else (middle, high)
    return high


def _range_distribution(q: float, count: int, degrees: int) -> float:
    """P(range / s ≤ q) = ∫ f(s) n ∫ φ(z) (Φ(z) − Φ(z − q s))ⁿ⁻¹ dz ds, s² a mean of `degrees` squares."""
    from scipy.special import gammaln, ndtr  # a third of a second, which no process pays at its start

    nodes, weights = _quadrature()
    s, ds = 2.5 * (nodes + 1), 2.5 * weights
    log_f = np.log(2) + degrees / 2 * np.log(degrees / 2) - gammaln(degrees / 2)
    log_f = log_f + (degrees - 1) * np.log(s) - degrees * s**2 / 2
    z, dz = 9 * nodes, 9 * weights
    between = np.maximum(ndtr(z) - ndtr(z - q * s[:, None]), 1e-300)
    inner = count * np.exp((count - 1) * np.log(between) - z**2 / 2) / np.sqrt(2 * np.pi)
    return float(np.exp(log_f) * ds @ (inner @ dz))


@lru_cache(1)
def _quadrature() -> tuple[Floats, Floats]:
    return np.polynomial.legendre.leggauss(128)
