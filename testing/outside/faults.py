"""Faults of an analytic drive: functions of its ideal data, before it is written.

**Conventions.** A mount fault is an error in the calibration: the LiDAR itself does not move. Faults of poses are the
receiver's. Each fault has its own random generator.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from testing.outside.ground import Array
from testing.outside.recording import Recordable, correlated, turned

Fault = Callable[[Recordable, np.random.Generator], Recordable]
SOUND = "sound"
LATE_S, FLOAT_M, FLOAT_CORRELATION_S, JUMP_M = 0.05, 0.1, 3.0, 0.6
RAIN_RATIO, DROPPED_RATIO, RAIN_REACH_M = 0.03, 0.15, 8.0


def _sound(drive: Recordable, _rng: np.random.Generator) -> Recordable:
    return drive


def _mount(up_m: float = 0.0, roll_deg: float = 0.0, pitch_deg: float = 0.0) -> Fault:
    """Return a fault that enters the LiDAR too high, or turned."""

    def fault(drive: Recordable, _rng: np.random.Generator) -> Recordable:
        entered = drive.ego_from_lidar.copy()
        entered[2, 3] += up_m
        entered[:3, :3] = entered[:3, :3] @ Rotation.from_euler("xy", [roll_deg, pitch_deg], degrees=True).as_matrix()
        return replace(drive, ego_from_lidar=entered)

    return fault


def _attitude(yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Fault:
    """Return a fault that turns the receiver's attitude in its body."""
    turn = Rotation.from_euler("zy", [yaw_deg, pitch_deg], degrees=True)
    return lambda drive, _rng: replace(drive, world_from_ins=turned(drive.world_from_ins, turn))


def _squatting(drive: Recordable, rng: np.random.Generator) -> Recordable:
    """Pitch the body and so the ego frame; LiDAR and receiver are entered as mounted."""
    return _attitude(pitch_deg=-2.0)(_mount(pitch_deg=2.0)(drive, rng), rng)


def _late(drive: Recordable, _rng: np.random.Generator) -> Recordable:
    return replace(drive, pose_s=drive.pose_s + LATE_S)


def _floating(drive: Recordable, rng: np.random.Generator) -> Recordable:
    drift = FLOAT_M * correlated(rng, len(drive.pose_s), 3, FLOAT_CORRELATION_S)
    return replace(drive, world_from_ins=_moved(drive.world_from_ins, drift), is_fixed=False)


def _jumping(drive: Recordable, rng: np.random.Generator) -> Recordable:
    """Move poses to one side from the middle of the drive on."""
    side = rng.uniform(0, 2 * np.pi)
    is_off = drive.pose_s > drive.pose_s.mean()
    off = np.outer(is_off, JUMP_M * np.array([np.cos(side), np.sin(side), 0.0]))
    return replace(drive, world_from_ins=_moved(drive.world_from_ins, off))


def _raining(drive: Recordable, rng: np.random.Generator) -> Recordable:
    """Let rays meet a nearby drop of rain, or return nothing."""
    drawn, ranges = rng.random(drive.ranges_m.shape, np.float32), drive.ranges_m.copy()
    ranges[drawn < DROPPED_RATIO] = np.inf
    wet = (drawn >= DROPPED_RATIO) & (drawn < DROPPED_RATIO + RAIN_RATIO)
    drops = rng.uniform(0.5, RAIN_REACH_M, int(wet.sum())).astype(np.float32)
    ranges[wet] = np.minimum(ranges[wet], drops)
    return replace(drive, ranges_m=ranges)


def _moved(poses: Array, by_m: Array) -> Array:
    moved = poses.copy()
    moved[:, :3, 3] += by_m
    return moved


FAULTS: Mapping[str, Fault] = {
    SOUND: _sound,
    "mount 10 cm low": _mount(up_m=-0.10),
    "mount 10 cm high": _mount(up_m=0.10),
    "mount 23 cm low": _mount(up_m=-0.23),
    "mount 23 cm high": _mount(up_m=0.23),
    "mount pitch 2°": _mount(pitch_deg=2.0),
    "mount pitch -2°": _mount(pitch_deg=-2.0),
    "mount roll 2°": _mount(roll_deg=2.0),
    "mount roll -2°": _mount(roll_deg=-2.0),
    "poses 50 ms late": _late,
    "RTK float 10 cm": _floating,
    "yaw bias 1°": _attitude(yaw_deg=1.0),
    "INS tilted 2°": _attitude(pitch_deg=2.0),
    "body pitched 2°": _squatting,
    "poses jump 0.6 m": _jumping,
    "rain": _raining,
}
