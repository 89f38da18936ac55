"""Simulated GNSS/INS receiver and IMU.

**Conventions.** The NovAtel driver stamps headers with the host's clock at publishing, 0–20 ms late; only the GPS week
and milliseconds state the time of validity. Attitude as in the receiver: roll right-down, pitch nose-up, azimuth
clockwise from north, with ROS rpy = (roll, −pitch, 90° − azimuth) (novatel_oem7_driver, Humble). INSPVAX heights are
ellipsoidal, BESTPOS heights above mean sea level.
"""

from dataclasses import dataclass, fields

import numpy as np
import pymap3d
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from simulator.options import SimulateOptions
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.scenery.world import ORIGIN_DEG_M
from simulator.sensors import rig
from stone.geometry.se3 import SE3, Array, multiply

FIX_NS = 50_000_000
GPS_EPOCH_UNIX_S = 315_964_800
LEAP_SECONDS = 18
WEEK_MS = 604_800_000
POSITION_NOISE_M = 0.010
ATTITUDE_NOISE_RAD = float(np.deg2rad(0.03))
NOISE_CORRELATION_S = 2.0
POSITION_STDEV_M = 0.012
UNDULATION_M = 45.5
GRAVITY_M_S2 = 9.80665
GYRO_NOISE_RAD_S = 0.002
ACCELERATION_NOISE_M_S2 = 0.03


@dataclass(frozen=True, eq=False)
class Fixes:
    """The receiver's solution at true times `stamps_ns` (N,), published at `host_stamps_ns`.

    `position_stdev_m` (N,) is the receiver's estimate for each axis; unless RTK is fixed, it floats.
    """

    stamps_ns: NDArray[np.int64]
    host_stamps_ns: NDArray[np.int64]
    geodetic_deg_m: Array
    velocity_enu_m_s: Array
    roll_pitch_azimuth_deg: Array
    is_rtk_fixed: NDArray[np.bool_]
    position_stdev_m: Array

    def where(self, is_kept: NDArray[np.bool_]) -> "Fixes":
        """Return the fixes of the mask (N,)."""
        return Fixes(**{part.name: getattr(self, part.name)[is_kept] for part in fields(self)})

    def gps_week_ms(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return GPS week and milliseconds of the week of the true times."""
        gps_ms = self.stamps_ns // 1_000_000 + (LEAP_SECONDS - GPS_EPOCH_UNIX_S) * 1000
        week, ms = np.divmod(gps_ms, WEEK_MS)
        return week, ms


def take_fixes(
    trajectory: DriveTrajectory, duration_ns: int, options: SimulateOptions, rng: np.random.Generator
) -> Fixes:
    """Return fixes at 20 Hz, RTK-like: the noise drifts smoothly over seconds. Both ends of the run are covered."""
    stamps = trajectory.start_ns + np.arange(0, duration_ns + FIX_NS, FIX_NS, dtype=np.int64)
    exact = trajectory.at(stamps) @ rig.EGO_FROM_INS
    ahead = trajectory.at(stamps + POSE_NS) @ rig.EGO_FROM_INS
    velocity = (ahead.translation_m - exact.translation_m) / (POSE_NS * 1e-9)
    noisy = _with_rtk_noise(exact, options.noise_ratio, rng)
    latitude, longitude, height = pymap3d.enu2geodetic(*noisy.translation_m.T, *ORIGIN_DEG_M)
    host = stamps + rng.integers(0, max(options.host_delay_max_ns, 1), len(stamps))
    attitude = np.rad2deg(novatel_attitude_rad(noisy))
    position, fixed = np.stack([latitude, longitude, height], axis=-1), np.ones(len(stamps), np.bool_)
    return Fixes(stamps, host, position, velocity, attitude, fixed, np.full(len(stamps), POSITION_STDEV_M))


def _with_rtk_noise(exact: SE3, noise_ratio: float, rng: np.random.Generator) -> SE3:
    sigma = NOISE_CORRELATION_S / (FIX_NS * 1e-9)
    drift = gaussian_filter1d(rng.standard_normal((len(exact) + int(8 * sigma), 6)), sigma, axis=0)
    drift = drift[int(4 * sigma) :][: len(exact)] * np.sqrt(2 * sigma * np.sqrt(np.pi)) * noise_ratio
    turn = np.concatenate([np.ones((len(exact), 1)), 0.5 * ATTITUDE_NOISE_RAD * drift[:, 3:]], axis=-1)
    return SE3.from_parts(multiply(exact.wxyz, turn), exact.translation_m + POSITION_NOISE_M * drift[:, :3])


def novatel_attitude_rad(map_from_ins: SE3) -> Array:
    """Return roll, pitch, azimuth (N, 3) of poses whose body is x forward, y left, z up."""
    r = map_from_ins.rotation()
    roll = np.arctan2(r[..., 2, 1], r[..., 2, 2])
    pitch_down = np.arcsin(np.clip(-r[..., 2, 0], -1, 1))
    yaw = np.arctan2(r[..., 1, 0], r[..., 0, 0])
    return np.stack([roll, -pitch_down, (np.pi / 2 - yaw) % (2 * np.pi)], axis=-1)


@dataclass(frozen=True, eq=False)
class Inertia:
    """IMU samples at 200 Hz: body rates and specific force, in the IMU frame."""

    stamps_ns: NDArray[np.int64]
    angular_velocity_rad_s: Array
    linear_acceleration_m_s2: Array


def take_inertia(
    trajectory: DriveTrajectory, duration_ns: int, rng: np.random.Generator, noise_ratio: float = 1.0
) -> Inertia:
    """Return samples from central differences of the exact poses, with white noise."""
    count = duration_ns // POSE_NS
    stamps = trajectory.start_ns + np.arange(count, dtype=np.int64) * POSE_NS
    centre = np.maximum(stamps, stamps[:1] + POSE_NS)  # the first sample has no predecessor
    before, here, after = (trajectory.at(centre + shift) @ rig.EGO_FROM_IMU for shift in (-POSE_NS, 0, POSE_NS))
    step_s = POSE_NS * 1e-9
    turn = (before.inverse() @ after).wxyz
    rates = turn[:, 1:] * np.sign(turn[:, :1]) / step_s
    force = (after.translation_m - 2 * here.translation_m + before.translation_m) / step_s**2
    force = gaussian_filter1d(force, 4, axis=0, mode="nearest") + np.array([0, 0, GRAVITY_M_S2])
    body_force = np.einsum("nji,nj->ni", here.rotation(), force)
    return Inertia(
        stamps,
        rates + noise_ratio * GYRO_NOISE_RAD_S * rng.standard_normal(rates.shape),
        body_force + noise_ratio * ACCELERATION_NOISE_M_S2 * rng.standard_normal(rates.shape),
    )
