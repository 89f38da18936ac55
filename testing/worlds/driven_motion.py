"""A robot's motion in closed form or drawn, for fits of motion: a track, and its sensors' measurements.

**Conventions.** Turns and ways are noise with the frequencies of a robot on rough ground, so no two drives are alike at
any lag. A hundred poses per second for `SECONDS`; everything is drawn from the seed.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.lag_fit import DopplerEvidence, TurnEvidence
from stone.sensors.sensor_motion import SensorMotion, sensor_motion

SECONDS, STEP_NS = 20.0, 10_000_000
GAP_NS = 250_000_000
EGO_FROM_SENSOR = SE3(np.array([1.0, 0, 0, 0, 1.0, 0.5, 1.0]))
Array = NDArray[np.float64]


def driven_track(seed: int) -> Trajectory:
    """Return the track of a robot that yaws slowly, rolls and pitches fast, and drives at varying speed."""
    rng, count = np.random.default_rng(seed), round(SECONDS * 1e9 / STEP_NS) + 1
    yaw_rate, pitch, roll = (_drawn(rng, count, *how) for how in ((40, 0.2), (12, 0.03), (12, 0.03)))
    forward, left, up = (_drawn(rng, count, *how) for how in ((60, 0.4), (60, 0.3), (15, 0.05)))
    step_s = STEP_NS * 1e-9
    places = np.stack([np.cumsum(1.5 + forward) * step_s, np.cumsum(left) * step_s, up], axis=1)
    angles = np.stack([roll, pitch, np.cumsum(yaw_rate) * step_s], axis=1)
    poses = np.concatenate([_wxyz(angles), places], axis=1)
    return Trajectory(np.arange(count, dtype=np.int64) * STEP_NS, SE3(poses))


def standing_track() -> Trajectory:
    count = round(SECONDS * 1e9 / STEP_NS) + 1
    return Trajectory(np.arange(count, dtype=np.int64) * STEP_NS, SE3(np.tile([1.0, 0, 0, 0, 0, 0, 0], (count, 1))))


def motion_of(track: Trajectory) -> SensorMotion:
    motion = sensor_motion(track, EGO_FROM_SENSOR, GAP_NS)
    if motion is None:
        raise ValueError("a track of 20 s has rates")
    return motion


def turns_seen(motion: SensorMotion, told: SensorMotion, late_s: float, seed: int, noise: float = 0.3) -> TurnEvidence:
    """Return pictures at 10 Hz, stamped `late_s` late, that moved by any mixture of turn and way."""
    rng = np.random.default_rng(seed)
    begin_s = np.arange(1.0, SECONDS - 2.0, 0.1)
    moved = told.between(begin_s, begin_s + 0.1) @ rng.normal(size=(6, 3))
    scatter = np.where(moved.std(axis=0) > 0, moved.std(axis=0), 1.0)
    measured = moved + noise * scatter * rng.normal(size=moved.shape)
    return TurnEvidence(motion, begin_s + late_s, begin_s + 0.1 + late_s, measured, has_way=True)


def speeds_seen(motion: SensorMotion, late_s: float, seed: int) -> DopplerEvidence:
    """Return twenty detections at 20 Hz, a tenth of them of moving objects."""
    rng = np.random.default_rng(seed)
    times_s = np.repeat(np.arange(1.0, SECONDS - 1.0, 0.05), 20)
    azimuth = rng.uniform(-1.0, 1.0, len(times_s))
    towards = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(times_s))], axis=1)
    rates = -np.einsum("ij,ij->i", towards, motion.velocity_at(times_s)) + 0.05 * rng.normal(size=len(times_s))
    moves = rng.random(len(times_s)) < 0.1
    rates[moves] += rng.normal(0.0, 2.0, int(moves.sum()))
    return DopplerEvidence(motion, times_s + late_s, towards, rates)


def _drawn(rng: np.random.Generator, count: int, width: int, deviation: float) -> Array:
    noise = gaussian_filter1d(rng.normal(size=count), width)
    return np.asarray(deviation * noise / noise.std())


def _wxyz(roll_pitch_yaw: Array) -> Array:
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw.T / 2), np.sin(roll_pitch_yaw.T / 2)
    columns = [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy]
    return np.stack([*columns, cr * cp * sy - sr * sp * cy], axis=-1)
