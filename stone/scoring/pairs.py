"""All pairs of a board at once: which entry surely does better than which.

    a is surely above b  where  (r_a − r_b) / √Var(r_a − r_b) > q(n, ν) / √2

with q the quantile of Tukey's studentised range of n entries. So that *any* two of n equally good entries are told
apart has the stated chance together, and the best of many lucky ones is not told apart from the last for its luck.

The variance is that of these places. For a pair of which these places tell nothing it is that of a new place, from the
pair's differences in whole sequences: it holds the luck of these places and that of the places, so a claim by it holds
for these places too.

**Conventions.** Coefficients are rows, (n, K) of `spectra.py`, of one ratio; ratios (n,).

Source: Tukey (1953), Kramer (1956), for unequal variances Games and Howell (1976).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.intervals import (
    FEWEST_SEQUENCES,
    LEAST_SPREAD,
    LEAST_WANDER,
    LEVEL,
    RatioSpectra,
    Scope,
    across_degrees,
    across_variance,
)
from stone.scoring.spectra import (
    FEWEST_DEGREES,
    Coefficients,
    Floats,
    SpectrumLayout,
    sampling_variances,
    sums_of_sequences,
)

PAIRS_AT_ONCE = 4096
Claims = NDArray[np.bool_]
Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class EntrySpectra:
    """Of one entry's ranked ratio: the coefficients (K,) and what `RatioSpectra` has beside them.

    `across_degrees` are the degrees of freedom across sequences.
    """

    layout: SpectrumLayout
    coefficients: Coefficients
    sequence_weight: Floats
    spread: float
    across_degrees: float


@dataclass(frozen=True, eq=False)
class BoardSpectra:
    """Those of n entries, one below another: coefficients (n, K), sequence weights (n, S), all others (n,)."""

    layout: SpectrumLayout
    coefficients: Coefficients
    sequence_weight: Floats
    spread: Floats
    across_degrees: Floats


@dataclass(frozen=True, eq=False)
class PairClaims:
    """`above` (n, n): whether entry a surely does better than b; `scopes`: the variances that pairs are compared by."""

    above: Claims
    scopes: tuple[Scope, ...]


def entry_spectra(spectra: RatioSpectra, column: int) -> EntrySpectra:
    """Return those of one of the ratios of a score."""
    return EntrySpectra(
        spectra.layout,
        np.ascontiguousarray(spectra.coefficients[:, column]),
        np.asarray(spectra.sequence_weight[:, column], np.float64),
        float(spectra.spread[column]),
        float(across_degrees(spectra)[column]),
    )


def board_spectra(entries: Sequence[EntrySpectra]) -> BoardSpectra:
    """Return the spectra of one entry or more, whose scores are by one ground truth, so of the same sequences."""
    return BoardSpectra(
        entries[0].layout,
        np.stack([one.coefficients for one in entries]),
        np.stack([one.sequence_weight for one in entries]),
        np.array([one.spread for one in entries]),
        np.array([one.across_degrees for one in entries]),
    )


def surely_above(values: NDArray[np.floating], spectra: BoardSpectra, level: float = LEVEL) -> PairClaims | None:
    """Return which entries surely do better than which; None if nothing can be said of any pair.

    Raises `ShapeError` where there are not as many values as entries.
    """
    count = len(spectra.coefficients)
    if values.shape != (count,):
        raise ShapeError("values", values.shape, f"({count},), one for each entry")
    above, scopes = np.zeros((count, count), np.bool_), set[Scope]()
    for first, second in _pairs(count):
        for scope, variances in VARIANCES:
            variance, degrees = variances(spectra, first, second)
            is_known = np.isfinite(variance)
            scopes |= {scope} if is_known.any() else set()
            a, b = first[is_known], second[is_known]
            reach = np.sqrt(variance[is_known]) * _critical(count, degrees[is_known], level)
            margin = values[a] - values[b]
            above[a, b], above[b, a] = margin > reach, -margin > reach
            first, second = first[~is_known], second[~is_known]
    return PairClaims(above, tuple(scope for scope, _ in VARIANCES if scope in scopes)) if scopes else None


def _within(spectra: BoardSpectra, first: Places, second: Places) -> tuple[Floats, Floats]:
    """Variances of these differences on these places, NaN if not known, and their degrees of freedom."""
    differences = spectra.coefficients[first].astype(np.float64) - spectra.coefficients[second]
    found = sampling_variances(differences, spectra.layout)
    is_spread = np.minimum(spectra.spread[first], spectra.spread[second]) >= LEAST_SPREAD
    return np.where(is_spread, found.variance, np.nan), found.degrees


def _across(spectra: BoardSpectra, first: Places, second: Places) -> tuple[Floats, Floats]:
    """Variances of these differences at a new place, NaN if not known, and their degrees of freedom."""
    sums = sums_of_sequences(spectra.coefficients.T.astype(np.float64), spectra.layout)
    differences = sums[:, first] - sums[:, second]
    weight = (spectra.sequence_weight[first] + spectra.sequence_weight[second]).T / 2
    degrees = np.minimum(spectra.across_degrees[first], spectra.across_degrees[second])
    is_known = (degrees >= FEWEST_DEGREES) & (np.ptp(differences, axis=0) > LEAST_WANDER)
    is_known &= len(sums) >= FEWEST_SEQUENCES
    return np.where(is_known, across_variance(differences, weight), np.nan), degrees


VARIANCES: tuple[tuple[Scope, Callable[[BoardSpectra, Places, Places], tuple[Floats, Floats]]], ...] = (
    ("these_places", _within),
    ("new_place", _across),
)
"""In the order in which they are tried."""


def _pairs(count: int) -> Iterator[tuple[Places, Places]]:
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
