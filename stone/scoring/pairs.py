"""Comparison of all pairs of a board: which entry is significantly better than which.

    a is significantly above b  if  (r_a − r_b) / √Var(r_a − r_b) > q(n, ν) / √2

with q the quantile of Tukey's studentised range of n entries. The probability that *any* two of n equally good entries
are separated is then the stated one. Among many pairs, some variance estimates are always far too small by chance.
Therefore every variance has a lower limit: the pair's power (sum of squared coefficients) times the median ratio of
variance to power. The median is over the board's pairs, which share the ground and its correlation.

The variance is that of these places. If it is known for too few pairs, the variance of unseen places is used, from the
pairs' differences in whole sequences. It includes the variation within and between places, so its claims also hold for
these places.

**Conventions.** Coefficients are rows, (n, K) of `spectra.py`, of one ratio; ratios (n,).

Source: Tukey (1953), Kramer (1956), for unequal variances Games and Howell (1976).
"""

from collections.abc import Callable, Sequence
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
LEAST_TOLD = 0.5  # share of pairs: with fewer known variances, the known ones are wrong more often
Claims = NDArray[np.bool_]
Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class EntrySpectra:
    """The ranked ratio of one entry: the coefficients (K,) and the other data of `RatioSpectra`.

    `across_degrees` are the degrees of freedom across sequences.
    """

    layout: SpectrumLayout
    coefficients: Coefficients
    sequence_weight: Floats
    spread: float
    across_degrees: float


@dataclass(frozen=True, eq=False)
class BoardSpectra:
    """The spectra of n entries, stacked: coefficients (n, K), sequence weights (n, S), all others (n,)."""

    layout: SpectrumLayout
    coefficients: Coefficients
    sequence_weight: Floats
    spread: Floats
    across_degrees: Floats


@dataclass(frozen=True, eq=False)
class PairClaims:
    """`above` (n, n): whether entry a is significantly better than b, by the variance of these places or of a new
    one.
    """

    above: Claims
    scope: Scope


def entry_spectra(spectra: RatioSpectra, column: int) -> EntrySpectra:
    """Return the spectra of one ratio of a score."""
    return EntrySpectra(
        spectra.layout,
        np.ascontiguousarray(spectra.coefficients[:, column]),
        np.asarray(spectra.sequence_weight[:, column], np.float64),
        float(spectra.spread[column]),
        float(across_degrees(spectra)[column]),
    )


def board_spectra(entries: Sequence[EntrySpectra]) -> BoardSpectra:
    """Return the stacked spectra of one or more entries with the same ground truth, and therefore the same
    sequences.
    """
    return BoardSpectra(
        entries[0].layout,
        np.stack([entry.coefficients for entry in entries]),
        np.stack([entry.sequence_weight for entry in entries]),
        np.array([entry.spread for entry in entries]),
        np.array([entry.across_degrees for entry in entries]),
    )


def surely_above(values: NDArray[np.floating], spectra: BoardSpectra, level: float = LEVEL) -> PairClaims | None:
    """Return which entries are significantly better than which; None if no pair can be compared.

    Raises `ShapeError` if the numbers of values and entries differ.
    """
    count = len(spectra.coefficients)
    if values.shape != (count,):
        raise ShapeError("values", values.shape, f"({count},), one per entry")
    first, second = np.triu_indices(count, 1)
    here = _in_parts(_within, spectra, first, second)
    if here.told >= LEAST_TOLD * len(first):
        return here.claims(values, level)
    elsewhere = _in_parts(_across, spectra, first, second)
    return (here if here.told >= elsewhere.told else elsewhere).claims(values, level)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """The pairs (p,): the variance of each difference (NaN if unknown), its degrees of freedom and its power."""

    scope: Scope
    first: Places
    second: Places
    variance: Floats
    degrees: Floats
    power: Floats

    @property
    def told(self) -> int:
        return int(np.isfinite(self.variance).sum())

    def claims(self, values: NDArray[np.floating], level: float) -> PairClaims | None:
        """Return the claims for entries with these values; None if no variance is known."""
        if not self.told:
            return None
        known = np.isfinite(self.variance)
        variance, power = self.variance[known], self.power[known]
        variance = np.maximum(variance, power * np.median(variance / power))
        reach = np.sqrt(variance) * _critical(len(values), self.degrees[known], level)
        first, second = self.first[known], self.second[known]
        margin = values[first] - values[second]
        above = np.zeros((len(values), len(values)), np.bool_)
        above[first, second], above[second, first] = margin > reach, -margin > reach
        return PairClaims(above, self.scope)


def _in_parts(
    pairs_of: Callable[[BoardSpectra, Places, Places], _Pairs], spectra: BoardSpectra, first: Places, second: Places
) -> _Pairs:
    """Return all pairs, computed in parts that fit into memory."""
    starts = range(0, max(1, len(first)), PAIRS_AT_ONCE)
    parts = [
        pairs_of(spectra, *(places[start : start + PAIRS_AT_ONCE] for places in (first, second))) for start in starts
    ]
    joined = (np.concatenate([getattr(part, name) for part in parts]) for name in ("variance", "degrees", "power"))
    return _Pairs(parts[0].scope, first, second, *joined)


def _within(spectra: BoardSpectra, first: Places, second: Places) -> _Pairs:
    differences = _differences(spectra, first, second)
    variances = sampling_variances(differences, spectra.layout)
    is_spread = np.minimum(spectra.spread[first], spectra.spread[second]) >= LEAST_SPREAD
    variance = np.where(is_spread, variances.variance, np.nan)
    return _Pairs("these_places", first, second, variance, variances.degrees, _power(differences, spectra.layout))


def _across(spectra: BoardSpectra, first: Places, second: Places) -> _Pairs:
    differences = _differences(spectra, first, second)
    sums = sums_of_sequences(differences.T, spectra.layout)
    weight = (spectra.sequence_weight[first] + spectra.sequence_weight[second]).T / 2
    degrees = np.minimum(spectra.across_degrees[first], spectra.across_degrees[second])
    power = _power(differences, spectra.layout)
    is_known = (degrees >= FEWEST_DEGREES) & (np.ptp(sums, axis=0) > LEAST_WANDER) & (power > 0)
    is_known &= len(sums) >= FEWEST_SEQUENCES
    return _Pairs("new_place", first, second, np.where(is_known, across_variance(sums, weight), np.nan), degrees, power)


def _differences(spectra: BoardSpectra, first: Places, second: Places) -> Floats:
    return np.asarray(spectra.coefficients[first].astype(np.float64) - spectra.coefficients[second])


def _power(differences: Floats, layout: SpectrumLayout) -> Floats:
    """Return the sum of squares (p,) of all coefficients except C_0."""
    return np.asarray((np.delete(differences, [run.start for run in layout.runs], axis=1) ** 2).sum(axis=1))


def _critical(count: int, degrees: Floats, level: float) -> Floats:
    """Return q / √2 for each pair; degrees are rounded down."""
    whole = np.floor(degrees).astype(np.int64)
    known = {freedom: range_quantile(count, freedom, level) / np.sqrt(2) for freedom in np.unique(whole).tolist()}
    return np.array([known[freedom] for freedom in whole.tolist()])


@lru_cache(4096)
def range_quantile(count: int, degrees: int, level: float = LEVEL) -> float:
    """Return the quantile of the studentised range of `count` ≥ 2 normal values, by bisection of its distribution."""
    low, high = 0.0, 64.0
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (low, middle) if _range_distribution(middle, count, degrees) > level else (middle, high)
    return high


def _range_distribution(q: float, count: int, degrees: int) -> float:
    """Return P(range / s ≤ q) = ∫ f(s) n ∫ φ(z) (Φ(z) − Φ(z − q s))ⁿ⁻¹ dz ds, s² a mean of `degrees` squares."""
    from scipy.special import gammaln, ndtr  # a lazy import: it takes a third of a second

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
