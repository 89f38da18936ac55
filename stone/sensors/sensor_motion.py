"""The motion of a mounted sensor in its own axes at any time of a track: speed, turn, and way between times.

**Conventions.** Times are seconds from the track's first pose. Rates use `HALF_SPAN_NS` before and after, so that pose
noise is smoothed symmetrically; NaN if poses are missing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, rotate
from stone.geometry.smooth_interpolation import rotation_vectors
from stone.geometry.trajectory import Trajectory

STEP_NS, HALF_SPAN_NS = 5_000_000, 25_000_000
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """`rates` (M, 6) are rotation (rad/s) and velocity (m/s) along the sensor's axes, every `STEP_NS` from `begin_s`.
    `sums` (M, 6) are their integrals; `unknown` (M,) counts the previous steps without a rate.
    """

    begin_s: float
    rates: Array
    sums: Array
    unknown: Array

    def velocity_at(self, times_s: Array) -> Array:
        """Return the velocity (N, 3) in m/s; NaN if unknown."""
        position = (times_s - self.begin_s) / (STEP_NS * 1e-9)
        velocity = np.stack([_linear(position, axis) for axis in self.rates[:, 3:].T], axis=1)
        return np.where(self._is_known(position, position)[:, None], velocity, np.nan)

    def between(self, begin_s: Array, end_s: Array) -> Array:
        """Return the turn in radians and the way in metres (N, 6) between two times; NaN if unknown."""
        first, last = ((times_s - self.begin_s) / (STEP_NS * 1e-9) for times_s in (begin_s, end_s))
        change = np.stack([_linear(last, axis) - _linear(first, axis) for axis in self.sums.T], axis=1)
        return np.where(self._is_known(first, last)[:, None], change, np.nan)

    def _is_known(self, first: Array, last: Array) -> NDArray[np.bool_]:
        most = len(self.rates) - 1
        is_inside = (first >= 0) & (last <= most)
        low, high = (np.clip(step, 0, most).astype(np.int64) for step in (np.floor(first), np.ceil(last)))
        before = np.where(low > 0, self.unknown[low - 1], 0)
        return np.asarray(is_inside & (self.unknown[high] == before))


def sensor_motion(track: Trajectory, ego_from_sensor: SE3, max_gap_ns: int) -> SensorMotion | None:
    """Return the motion, or None for a track that is too short for a rate."""
    times_ns = np.arange(track.stamps_ns[0] + HALF_SPAN_NS, track.stamps_ns[-1] - HALF_SPAN_NS, STEP_NS)
    if len(times_ns) < 2:
        return None
    before, after = (track.at(times_ns + at_ns, max_gap_ns) for at_ns in (-HALF_SPAN_NS, HALF_SPAN_NS))
    is_known = before.is_ok & after.is_ok & (before.segment == after.segment)
    first, last = (poses.map_from_ego @ ego_from_sensor for poses in (before, after))
    way_sensor = rotate(first.inverse().wxyz, last.translation_m - first.translation_m)
    turn_sensor = rotation_vectors((first.inverse() @ last).wxyz)
    # Halfway, the sensor has turned by half: its velocity is expressed in these axes.
    half = np.cross(turn_sensor / 2, way_sensor)
    rates = np.concatenate([turn_sensor, way_sensor - half], axis=1) / (2 * HALF_SPAN_NS * 1e-9)
    rates = np.where(is_known[:, None], rates, 0.0)
    steps = (rates[1:] + rates[:-1]) / 2 * (STEP_NS * 1e-9)
    sums = np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)])
    return SensorMotion(HALF_SPAN_NS * 1e-9, rates, sums, np.cumsum(~is_known).astype(np.float64))


def _linear(position: Array, values: Array) -> Array:
    return np.asarray(np.interp(position, np.arange(len(values)), values))
