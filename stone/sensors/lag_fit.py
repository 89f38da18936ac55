"""The offset of a clock at which what sensors measured agrees best with how the robot moved, and its standard error.

    r(t + offset) = measured(t) − predicted(t + offset),   Σ ρ(r / scale) least

**Conventions.** An offset is added to the sensors' times, seconds. It is first searched on a grid, by the profile
likelihood of residuals of unknown scale, then found by Gauss and Newton, each residual that is far off weighted down.
The standard error is measured: by what the blocks of `BLOCK_S` say apart from each other (so errors that last are not
counted as many), not by the size of the residuals. What could be at two times is not told.
Sources: Huber 1981; Liang and Zeger 1986 (errors by clusters); Vuong 1989 (which of two models is likelier).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.sensors.clocks import MAD_TO_SIGMA
from stone.sensors.sensor_motion import SensorMotion

COARSE_STEP_S = 0.02
ROUNDS, SETTLED_S = 12, 1e-6
# Beyond so many scales a residual is somebody else's motion.
FAR_SCALES = 3.0
HUBER_SCALES = 1.345
# Of what is predicted at the offset at which most is.
LEAST_KNOWN_RATIO = 0.75
BLOCK_S, FEWEST_BLOCKS = 0.5, 8
# So many standard errors the best offset is better than the best that is `APART_S` away.
LEAST_LEAD, APART_S = 4.0, 0.3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LagResiduals:
    """N times D residuals at an offset, how they change with it (N, D) per second, and when they were measured (N,).

    Each column has a scale of its own; a row is NaN where nothing is predicted.
    """

    values: Array
    slopes_per_s: Array
    times_s: Array

    @property
    def is_known(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.values + self.slopes_per_s).all(axis=1))


class LagEvidence(Protocol):
    """What one sensor measured."""

    def values(self, offset_s: float) -> Array:
        """Residuals (N, D) at an offset; a row is NaN where nothing is predicted."""
        ...

    def residuals(self, offset_s: float) -> LagResiduals:
        """The same, and how they change."""
        ...


@dataclass(frozen=True)
class LagFit:
    """`lead` is by how many of its standard errors the offset explains more than any that is `APART_S` away."""

    offset_s: float
    sigma_s: float
    lead: float


def fitted_lag(evidence: Sequence[LagEvidence], span_s: tuple[float, float]) -> LagFit | None:
    """Searched between two offsets. None where nothing stands out, or what does is at an end of the search."""
    searched = np.arange(span_s[0], span_s[1] + COARSE_STEP_S / 2, COARSE_STEP_S)
    found = [_cost(evidence, offset_s) for offset_s in searched.tolist()]
    costs, known = (np.array(column) for column in zip(*found, strict=True))
    costs[known < max(1.0, LEAST_KNOWN_RATIO * known.max())] = np.inf
    best = int(np.argmin(costs))
    if best in (0, len(searched) - 1) or not np.isfinite(costs[best - 1 : best + 2]).all():
        return None
    others = np.where(np.abs(searched - searched[best]) > APART_S, costs, np.inf)
    lead = _lead(evidence, float(searched[best]), float(searched[np.argmin(others)]))
    refined = _refined(evidence, float(searched[best]))
    return None if refined is None or lead < LEAST_LEAD else LagFit(*refined, lead)


def _cost(evidence: Sequence[LagEvidence], offset_s: float) -> tuple[float, int]:
    """−2 log likelihood, the scale of each sensor's residuals at its best, and of how many rows it is known."""
    total, known_rows = 0.0, 0
    for sensor in evidence:
        values = sensor.values(offset_s)
        known = values[np.isfinite(values).all(axis=1)]
        known_rows += len(known)
        if len(known):
            total += len(values) * float(_costs(known).mean())
    return total, known_rows


def _lead(evidence: Sequence[LagEvidence], best_s: float, other_s: float) -> float:
    """How much likelier what was measured is at the one than at the other, in standard errors of that by blocks."""
    times, gains = list[Array](), list[Array]()
    for sensor in evidence:
        one, two = sensor.residuals(best_s), sensor.values(other_s)
        is_known = one.is_known & np.isfinite(two).all(axis=1)
        if is_known.any():
            times.append(one.times_s[is_known])
            gains.append(_costs(two[is_known]) - _costs(one.values[is_known]))
    if not times:
        return 0.0
    blocks = _by_block(np.concatenate(times), np.concatenate(gains))
    scatter = float(blocks.std(ddof=1)) if len(blocks) >= FEWEST_BLOCKS else 0.0
    return float(blocks.sum() / (scatter * np.sqrt(len(blocks)))) if scatter > 0 else 0.0


def _costs(values: Array) -> Array:
    """Of each row (N,), the scale of each column at its best."""
    near = np.minimum(np.abs(values), FAR_SCALES * _scales(values)) ** 2
    mean = near.mean(axis=0) + 1e-30
    return np.asarray((near / mean + np.log(mean)).sum(axis=1))


def _by_block(times_s: Array, values: Array) -> Array:
    """Sums over the blocks of time that have any."""
    numbers = np.unique(np.floor(times_s / BLOCK_S), return_inverse=True)[1]
    return np.asarray(np.bincount(numbers, values), np.float64)


def _scales(values: Array) -> Array:
    """Of each column (D,)."""
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(values), axis=0) + 1e-15)


def _refined(evidence: Sequence[LagEvidence], offset_s: float) -> tuple[float, float] | None:
    """(offset, standard error); None where nothing changes with the offset, or too few blocks say so."""
    start_s = offset_s
    for _ in range(ROUNDS):
        scores, energy = _normal(evidence, offset_s)
        if energy <= 0:
            return None
        change_s = float(np.clip(-scores.sum() / energy, -COARSE_STEP_S, COARSE_STEP_S))
        offset_s += change_s
        if abs(change_s) < SETTLED_S:
            break
    scores, energy = _normal(evidence, offset_s)
    blocks = len(scores)
    if blocks < FEWEST_BLOCKS or energy <= 0 or abs(offset_s - start_s) > 2 * COARSE_STEP_S:
        return None
    return offset_s, float(np.sqrt(np.sum(scores**2) * blocks / (blocks - 1))) / energy


def _normal(evidence: Sequence[LagEvidence], offset_s: float) -> tuple[Array, float]:
    """What each block of time asks to change, and how much all know of the offset."""
    parts, energy = list[tuple[Array, Array]](), 0.0
    for sensor in evidence:
        found = sensor.residuals(offset_s)
        known = found.is_known
        values, slopes = found.values[known], found.slopes_per_s[known]
        scales = _scales(values) if len(values) else np.ones(values.shape[1])
        weights = np.minimum(1.0, HUBER_SCALES * scales / np.maximum(np.abs(values), 1e-300)) / scales**2
        weights[np.abs(values) > 2 * FAR_SCALES * scales] = 0.0
        energy += float(np.sum(weights * slopes**2))
        parts.append((found.times_s[known], (weights * slopes * values).sum(axis=1)))
    times_s, scores = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _by_block(times_s, scores), energy


# What tells a clock's offset: the turns that cameras or a gyro measured, and the speeds that radars did.
#
# **Conventions.** Times are seconds from the track's first pose, by the clock that is in question. Source of the
# second: Kellner et al., "Instantaneous ego-motion estimation using Doppler radar", ITSC 2013.


SLOPE_STEP_S = 0.005


@dataclass(frozen=True, eq=False)
class TurnEvidence:
    """K measurements (K, D) between two times each, which the turn, and with `has_way` the way, explain linearly.

    How much of each explains how much of what was measured is fitted: neither the mount, the lens nor the distance of
    what is seen need be known.
    """

    motion: SensorMotion
    begin_s: Array
    end_s: Array
    measured: Array
    has_way: bool

    def values(self, offset_s: float) -> Array:
        """(K, D) what the robot's motion does not explain."""
        return self._beside(self._explaining(offset_s), None)[0]

    def residuals(self, offset_s: float) -> LagResiduals:
        """As `values`, and how they change. The change of the fit itself is left out (Kaufman 1975): it is of second
        order where the residuals are small."""
        later, earlier = self._explaining(offset_s + SLOPE_STEP_S), self._explaining(offset_s - SLOPE_STEP_S)
        found = self._beside(self._explaining(offset_s), (later - earlier) / (2 * SLOPE_STEP_S))
        return LagResiduals(*found, (self.begin_s + self.end_s) / 2)

    def _beside(self, explaining: Array, slopes: Array | None) -> tuple[Array, Array]:
        """Residuals once what explains is fitted, and what the slopes change that no fit explains as well."""
        known = np.isfinite(explaining if slopes is None else explaining + slopes).all(axis=1)
        values, changes = np.full(self.measured.shape, np.nan), np.full(self.measured.shape, np.nan)
        if known.sum() <= 2 * explaining.shape[1]:
            return values, changes
        measured, basis = self.measured[known], np.linalg.qr(explaining[known])[0]
        values[known] = measured - basis @ (basis.T @ measured)
        if slopes is not None:
            changed = slopes[known] @ np.linalg.lstsq(explaining[known], measured, rcond=None)[0]
            changes[known] = basis @ (basis.T @ changed) - changed
        return values, changes

    def _explaining(self, offset_s: float) -> Array:
        """Columns (K, P): turn, way if it counts, and one for what is constant."""
        moved = self.motion.between(self.begin_s + offset_s, self.end_s + offset_s)
        elapsed_s = (self.end_s - self.begin_s)[:, None]
        return np.concatenate([moved if self.has_way else moved[:, :3], elapsed_s], axis=1)


@dataclass(frozen=True, eq=False)
class DopplerEvidence:
    """N detections: when (N,), unit directions (N, 3) in the radar's axes, and rates of range (N,), m/s, growing."""

    motion: SensorMotion
    times_s: Array
    towards: Array
    range_rate_m_s: Array

    def values(self, offset_s: float) -> Array:
        """(N, 1) what the robot's own speed does not explain."""
        velocity = self.motion.velocity_at(self.times_s + offset_s)
        approach = np.einsum("ij,ij->i", self.towards, velocity)
        return np.asarray(self.range_rate_m_s + approach)[:, None]

    def residuals(self, offset_s: float) -> LagResiduals:
        """As `values`, and how they change."""
        later, earlier = self.values(offset_s + SLOPE_STEP_S), self.values(offset_s - SLOPE_STEP_S)
        return LagResiduals(self.values(offset_s), (later - earlier) / (2 * SLOPE_STEP_S), self.times_s)
