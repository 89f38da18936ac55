"""The clock offset at which a sensor's measurements agree best with the robot's motion, and its standard error.

    r(t + offset) = measured(t) − predicted(t + offset),   minimise Σ ρ(r / scale)

**Conventions.** An offset in seconds is added to the sensors' times. It is first searched on a grid, by the profile
likelihood of residuals of unknown scale, then refined by Gauss–Newton with smaller weights for outliers. The standard
error comes from the disagreement of the blocks of `BLOCK_S` (so that lasting errors are not counted repeatedly), not
from the residuals' size. Ambiguous offsets are not returned. Sources: Huber 1981; Liang and Zeger 1986 (errors by
clusters); Vuong 1989 (likelihood comparison of two models).
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
# Residuals beyond this many scales come from other moving objects.
FAR_SCALES = 3.0
HUBER_SCALES = 1.345
# Threshold, relative to the best-supported offset.
LEAST_KNOWN_RATIO = 0.75
BLOCK_S, FEWEST_BLOCKS = 0.5, 8
# The best offset must be this many standard errors better than the best offset at least `APART_S` away.
LEAST_LEAD, APART_S = 4.0, 0.3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LagResiduals:
    """N times D residuals at an offset, their derivative (N, D) per second, and their measurement times (N,).

    Each column has its own scale; rows without a prediction are NaN.
    """

    values: Array
    slopes_per_s: Array
    times_s: Array

    @property
    def is_known(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.values + self.slopes_per_s).all(axis=1))


class LagEvidence(Protocol):
    """The measurements of one sensor."""

    def values(self, offset_s: float) -> Array:
        """Return the residuals (N, D) at an offset; rows without a prediction are NaN."""
        ...

    def residuals(self, offset_s: float) -> LagResiduals:
        """Return the residuals and their derivative."""
        ...


@dataclass(frozen=True)
class LagFit:
    """`lead` is the advantage over all offsets at least `APART_S` away, in standard errors."""

    offset_s: float
    sigma_s: float
    lead: float


def fitted_lag(evidence: Sequence[LagEvidence], span_s: tuple[float, float]) -> LagFit | None:
    """Return the best offset between two limits; None if nothing stands out, or the best offset is at a limit."""
    searched = np.arange(span_s[0], span_s[1] + COARSE_STEP_S / 2, COARSE_STEP_S)
    results = [_cost(evidence, offset_s) for offset_s in searched.tolist()]
    costs, known = (np.array(column) for column in zip(*results, strict=True))
    costs[known < max(1.0, LEAST_KNOWN_RATIO * known.max())] = np.inf
    best = int(np.argmin(costs))
    if best in (0, len(searched) - 1) or not np.isfinite(costs[best - 1 : best + 2]).all():
        return None
    others = np.where(np.abs(searched - searched[best]) > APART_S, costs, np.inf)
    lead = _lead(evidence, float(searched[best]), float(searched[np.argmin(others)]))
    refined = _refined(evidence, float(searched[best]))
    return None if refined is None or lead < LEAST_LEAD else LagFit(*refined, lead)


def _cost(evidence: Sequence[LagEvidence], offset_s: float) -> tuple[float, int]:
    """Return −2 log likelihood with the best scale of each sensor's residuals, and the number of known rows."""
    total, known_rows = 0.0, 0
    for sensor in evidence:
        values = sensor.values(offset_s)
        known = values[np.isfinite(values).all(axis=1)]
        known_rows += len(known)
        if len(known):
            total += len(values) * float(_costs(known).mean())
    return total, known_rows


def _lead(evidence: Sequence[LagEvidence], best_s: float, other_s: float) -> float:
    """Return the log-likelihood advantage of the best offset over another, in standard errors by blocks."""
    times, gains = list[Array](), list[Array]()
    for sensor in evidence:
        best, other = sensor.residuals(best_s), sensor.values(other_s)
        is_known = best.is_known & np.isfinite(other).all(axis=1)
        if is_known.any():
            times.append(best.times_s[is_known])
            gains.append(_costs(other[is_known]) - _costs(best.values[is_known]))
    if not times:
        return 0.0
    blocks = _by_block(np.concatenate(times), np.concatenate(gains))
    scatter = float(blocks.std(ddof=1)) if len(blocks) >= FEWEST_BLOCKS else 0.0
    return float(blocks.sum() / (scatter * np.sqrt(len(blocks)))) if scatter > 0 else 0.0


def _costs(values: Array) -> Array:
    """Return the cost of each row (N,), with the best scale of each column."""
    near = np.minimum(np.abs(values), FAR_SCALES * _scales(values)) ** 2
    mean = near.mean(axis=0) + 1e-30
    return np.asarray((near / mean + np.log(mean)).sum(axis=1))


def _by_block(times_s: Array, values: Array) -> Array:
    """Return the sums over non-empty blocks of time."""
    numbers = np.unique(np.floor(times_s / BLOCK_S), return_inverse=True)[1]
    return np.asarray(np.bincount(numbers, values), np.float64)


def _scales(values: Array) -> Array:
    """Return the robust scale of each column (D,)."""
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(values), axis=0) + 1e-15)


def _refined(evidence: Sequence[LagEvidence], offset_s: float) -> tuple[float, float] | None:
    """Return (offset, standard error); None if nothing changes with the offset, or too few blocks contribute."""
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
    """Return each block's gradient, and the total information about the offset."""
    parts, energy = list[tuple[Array, Array]](), 0.0
    for sensor in evidence:
        measured = sensor.residuals(offset_s)
        known = measured.is_known
        values, slopes = measured.values[known], measured.slopes_per_s[known]
        scales = _scales(values) if len(values) else np.ones(values.shape[1])
        weights = np.minimum(1.0, HUBER_SCALES * scales / np.maximum(np.abs(values), 1e-300)) / scales**2
        weights[np.abs(values) > 2 * FAR_SCALES * scales] = 0.0
        energy += float(np.sum(weights * slopes**2))
        parts.append((measured.times_s[known], (weights * slopes * values).sum(axis=1)))
    times_s, scores = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _by_block(times_s, scores), energy


# Evidence of a clock's offset: turns measured by cameras or a gyro, and speeds measured by radars. Times are seconds
# from the track's first pose, by the examined clock. Source of the second: Kellner et al., "Instantaneous ego-motion
# estimation using Doppler radar", ITSC 2013.


SLOPE_STEP_S = 0.005


@dataclass(frozen=True, eq=False)
class TurnEvidence:
    """K measurements (K, D) between two times each, explained linearly by the turn and, with `has_way`, the way.

    The coefficients are fitted, so mount, lens and distance of the scene need not be known.
    """

    motion: SensorMotion
    begin_s: Array
    end_s: Array
    measured: Array
    has_way: bool

    def values(self, offset_s: float) -> Array:
        """Return the measurements (K, D) that the robot's motion does not explain."""
        return self._beside(self._explaining(offset_s), None)[0]

    def residuals(self, offset_s: float) -> LagResiduals:
        """Return `values` and their derivative. The change of the fit itself is neglected (Kaufman 1975): it is of
        second order for small residuals.
        """
        later, earlier = self._explaining(offset_s + SLOPE_STEP_S), self._explaining(offset_s - SLOPE_STEP_S)
        fitted = self._beside(self._explaining(offset_s), (later - earlier) / (2 * SLOPE_STEP_S))
        return LagResiduals(*fitted, (self.begin_s + self.end_s) / 2)

    def _beside(self, explaining: Array, slopes: Array | None) -> tuple[Array, Array]:
        """Return the residuals of the fit, and the part of the slopes that the fit does not explain."""
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
        """Return the explaining columns (K, P): turn, way if used, and a constant."""
        moved = self.motion.between(self.begin_s + offset_s, self.end_s + offset_s)
        elapsed_s = (self.end_s - self.begin_s)[:, None]
        return np.concatenate([moved if self.has_way else moved[:, :3], elapsed_s], axis=1)


@dataclass(frozen=True, eq=False)
class DopplerEvidence:
    """N detections: times (N,), unit directions (N, 3) in the radar's axes, and range rates (N,) in m/s, positive for
    growing range.
    """

    motion: SensorMotion
    times_s: Array
    towards: Array
    range_rate_m_s: Array

    def values(self, offset_s: float) -> Array:
        """Return the range rates (N, 1) that the robot's speed does not explain."""
        velocity = self.motion.velocity_at(self.times_s + offset_s)
        approach = np.einsum("ij,ij->i", self.towards, velocity)
        return np.asarray(self.range_rate_m_s + approach)[:, None]

    def residuals(self, offset_s: float) -> LagResiduals:
        """Return `values` and their derivative."""
        later, earlier = self.values(offset_s + SLOPE_STEP_S), self.values(offset_s - SLOPE_STEP_S)
        return LagResiduals(self.values(offset_s), (later - earlier) / (2 * SLOPE_STEP_S), self.times_s)
