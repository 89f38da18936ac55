"""Cameras that are triggered by a spinning LiDAR: the LiDAR's direction over time, and whether cameras follow it.

**Conventions.** Azimuth is atan2(y, x) in the LiDAR's frame, radians. Times are ns after the sweep's stamp, and times
one revolution apart are equal: differences are computed on the circle of the period, in [−period/2, period/2). A camera
should fire when the LiDAR scans along its optical axis. Delays common to all cameras (an exposure's delay, late LiDAR
stamps) are separated from the delay of single cameras.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FULL_TURN_RAD = 2 * np.pi
# For an evenly turning LiDAR, every point's azimuth follows from its time; other LiDARs have no such direction.
LEAST_AGREEMENT = 0.9
LEAST_RANGE_M = 0.5
ON_TIME_NS = 2_000_000  # design §3
# Free-running cameras agree with the LiDAR's direction by chance: half of six in 0.6 % of rigs. With an arbitrary
# delay, half agree in 10 %, two thirds in 1 %.
AGREEING_RATIO, AGREEING_LATE_RATIO = 1 / 2, 2 / 3
LEAST_AGREEING_LATE = 2


@dataclass(frozen=True)
class LidarRotation:
    """A LiDAR with one revolution per period: `direction` +1 with the azimuth, −1 against it."""

    direction: int
    start_rad: float
    period_ns: int

    def time_ns(self, azimuth_rad: float) -> int:
        """Return the time after the stamp at which it scans this azimuth, in [0, period)."""
        turned_rad = (self.direction * (azimuth_rad - self.start_rad)) % FULL_TURN_RAD
        return round(turned_rad / FULL_TURN_RAD * self.period_ns) % self.period_ns


@dataclass(frozen=True, eq=False)
class Triggers:
    """For C cameras: `shared_ns` is their common delay, `late_ns` (C,) each camera's additional delay.

    `looks_as` (C,) is the camera whose axis the LiDAR scans when this one fires; the camera itself if it is not
    swapped.
    """

    shared_ns: int
    late_ns: NDArray[np.int64]
    looks_as: NDArray[np.int64]


def wrapped_ns(difference_ns: NDArray[np.int64], period_ns: int) -> NDArray[np.int64]:
    """Return differences on the circle of a period, in [−period/2, period/2)."""
    half_ns = period_ns // 2
    return np.asarray((difference_ns + half_ns) % period_ns - half_ns, np.int64)


def look_of(points_lidar: NDArray[np.floating], offset_ns: NDArray[np.int64], period_ns: int) -> LidarRotation | None:
    """Return the rotation from points (N, 3) and their times (N,) in one or more sweeps; None if it is not even.

    Points of one packet share the time of its start, so half of their spread is subtracted, at most half the step
    between packets. Points nearer than `LEAST_RANGE_M` in plan have no bearing.
    """
    x, y = points_lidar[:, 0].astype(np.float64), points_lidar[:, 1].astype(np.float64)
    is_far = np.hypot(x, y) > LEAST_RANGE_M
    if not is_far.any() or period_ns <= 0:
        return None
    azimuth, times_ns = np.arctan2(y[is_far], x[is_far]), offset_ns[is_far]
    turned = FULL_TURN_RAD * (times_ns % period_ns) / period_ns
    means = {direction: np.exp(1j * (azimuth - direction * turned)).mean() for direction in (1, -1)}
    direction = max(means, key=lambda way: abs(means[way]))
    if abs(means[direction]) < LEAST_AGREEMENT:
        return None
    middle = float(np.angle(means[direction]))
    rest = np.angle(np.exp(1j * (azimuth - direction * turned - middle)))
    start = middle + float(np.median(rest)) - direction * _half_packet_rad(rest, times_ns, period_ns)
    return LidarRotation(direction, start, period_ns)


def _half_packet_rad(rest: Array, times_ns: NDArray[np.int64], period_ns: int) -> float:
    """Return half the angle that a packet covers while its points have one time."""
    order = np.argsort(times_ns, kind="stable")
    begins = np.flatnonzero(np.diff(times_ns[order], prepend=times_ns[order[0]] - 1))
    if len(begins) < 2:
        return 0.0
    spread = np.maximum.reduceat(rest[order], begins) - np.minimum.reduceat(rest[order], begins)
    step_rad = float(np.median(np.diff(times_ns[order][begins]))) / period_ns * FULL_TURN_RAD
    return min(float(np.median(spread)), step_rad) / 2


def triggers_of(fired_ns: NDArray[np.int64], looks_ns: NDArray[np.int64], period_ns: int) -> Triggers | None:
    """Return the triggers from the firing times and scan times (C,) of C cameras; None if the cameras do not follow the
    LiDAR.

    They follow it if half of them fire when the LiDAR scans their direction, or two thirds with a common delay,
    including cameras that are swapped among themselves.
    """
    if len(fired_ns) < 2:
        return None
    away_ns = wrapped_ns(fired_ns[:, None] - looks_ns[None, :], period_ns)
    delays = [0, *np.diag(away_ns).tolist()]
    fits = [_with_delay(away_ns, delay_ns, period_ns) for delay_ns in delays]
    counts = [int(is_explained.sum()) for _triggers, is_explained in fits]
    best = max(range(len(fits)), key=lambda at: (counts[at], -abs(delays[at])))
    late_least = max(LEAST_AGREEING_LATE, AGREEING_LATE_RATIO * len(fired_ns))
    least = AGREEING_RATIO * len(fired_ns) if abs(delays[best]) <= ON_TIME_NS else late_least
    return fits[best][0] if counts[best] >= least else None


def _with_delay(away_ns: NDArray[np.int64], delay_ns: int, period_ns: int) -> tuple[Triggers, NDArray[np.bool_]]:
    """Return the triggers for a common delay of `delay_ns`, and the cameras (C,) that it explains."""
    cameras = np.arange(len(away_ns))
    late_ns = wrapped_ns(np.diag(away_ns) - delay_ns, period_ns)
    fits = np.abs(late_ns) <= ON_TIME_NS
    shared_ns = delay_ns + round(float(np.median(late_ns[fits]))) if fits.any() else delay_ns
    apart_ns = wrapped_ns(away_ns - shared_ns, period_ns)
    nearest = np.abs(apart_ns).argmin(axis=1)
    is_candidate = ~fits & (np.abs(apart_ns[cameras, nearest]) <= ON_TIME_NS)
    is_swapped = is_candidate & _is_exchanged(nearest, is_candidate)
    looks_as = np.where(is_swapped, nearest, cameras)
    late_ns = np.where(is_swapped, 0, np.diag(apart_ns))
    return Triggers(shared_ns, late_ns, looks_as), fits | is_swapped


def _is_exchanged(nearest: NDArray[np.int64], is_candidate: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cameras (C,) on a cycle of `nearest` among the candidates: each is at the position of another swapped
    camera.
    """
    on_cycle = np.zeros(len(nearest), np.bool_)
    for camera in np.flatnonzero(is_candidate).tolist():
        camera_at, steps = int(nearest[camera]), 1
        while is_candidate[camera_at] and camera_at != camera and steps < len(nearest):
            camera_at, steps = int(nearest[camera_at]), steps + 1
        on_cycle[camera] = camera_at == camera and steps > 1
    return on_cycle
