"""What tells a clock's offset: the turns that cameras or a gyro measured, and the speeds that radars did.

**Conventions.** Times are seconds from the track's first pose, by the clock that is in question. Source of the second:
Kellner et al., "Instantaneous ego-motion estimation using Doppler radar", ITSC 2013.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.sensors.lag_fit import LagResiduals
from stone.sensors.sensor_motion import SensorMotion

SLOPE_STEP_S = 0.005
Array = NDArray[np.float64]


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
