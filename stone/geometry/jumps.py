"""Jumps of a track: steps that no vehicle can have made, and across which nothing may be interpolated.

**Conventions.** Steps are between neighbouring poses: K poses have K − 1. A step is compared with the surrounding
velocities (the median of five, including its own), so that a fast vehicle is no jump and an outlier gives two. A step
is a jump if it misses the expected position by more than a·dt² (a: the vehicle's acceleration) plus the source's noise.
An implausibly fast turn is a jump too.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import steps_of
from stone.geometry.trajectory import Trajectory

WINDOW = 5
LEAST_STEPS = WINDOW // 2 + 1


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a ground vehicle's motion, and the noise of the poses.

    With too few poses to estimate the usual speed, only `speed_m_s` applies. If the status of the solution changes (RTK
    lost or regained), half the noise already counts as a jump.
    """

    speed_m_s: float = 15.0
    acceleration_m_s2: float = 8.0
    turn_rad_s: float = 2 * np.pi
    noise_m: float = 0.10


@dataclass(frozen=True, eq=False)
class Jumps:
    """The steps (J,) that are jumps: step k is from pose k to pose k + 1 and missed its position by `excess_m` (J,)."""

    steps: NDArray[np.int64]
    excess_m: NDArray[np.float64]


def jumps_of(
    trajectory: Trajectory, has_changed: NDArray[np.bool_] | None = None, limits: MotionLimits | None = None
) -> Jumps:
    """Return the jumps of a trajectory; `has_changed` (K − 1,) marks steps over which the solution status changed."""
    limits = limits or MotionLimits()
    dt_s = np.diff(trajectory.stamps_ns) * 1e-9
    rate_m_s = np.diff(trajectory.map_from_ego.translation_m, axis=0) / dt_s[:, None]
    if len(dt_s) < LEAST_STEPS:
        excess_m = np.maximum(np.linalg.norm(rate_m_s, axis=1) - limits.speed_m_s, 0) * dt_s
        allowed_m = np.zeros(len(dt_s))
    else:
        excess_m = np.linalg.norm(rate_m_s - _usual(rate_m_s), axis=1) * dt_s
        allowed_m = limits.acceleration_m_s2 * dt_s**2 + limits.noise_m
    if has_changed is not None:
        allowed_m = allowed_m - np.where(has_changed, np.minimum(limits.noise_m / 2, allowed_m), 0)
    is_jump = (excess_m > allowed_m) | (steps_of(trajectory.map_from_ego)[1] > limits.turn_rad_s * dt_s)
    steps = np.flatnonzero(is_jump).astype(np.int64)
    return Jumps(steps, excess_m[steps])


def split(trajectory: Trajectory, steps: NDArray[np.int64]) -> Trajectory:
    """Return the trajectory with a new segment after each of these steps, or itself if there are none."""
    if not len(steps):
        return trajectory
    begins = np.zeros(len(trajectory), np.int64)
    begins[steps + 1] = 1
    return replace(trajectory, segment=np.cumsum(begins))


def _usual(rate_m_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, per step, the median velocity of the surrounding steps (M, 3); mirrored at the ends, M ≥ 3."""
    padded = np.pad(rate_m_s, ((WINDOW // 2, WINDOW // 2), (0, 0)), mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, WINDOW, axis=0)
    return np.asarray(np.median(around, axis=-1), dtype=np.float64)
