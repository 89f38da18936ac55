"""The driving direction of a robot in the frame of its poses: a bias of heading or pitch shows in every step.

**Conventions.** Wheels and tracks drive along x of the ego frame. A step is the motion between two poses at least
`STEP_M` apart, in the ego frame of the pose midway; backward and strongly sideways steps are ignored. Yaw is positive
to the left of x, pitch positive above it. Both apply to straight driving: a line over the turn per metre is fitted, and
steps far from the line are excluded, so that bumps have no effect. The sum of the steps' yaw deviations from the line
is the sideways drift of the poses, because headings are independent of positions that drift to and fro.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, multiply
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.clocks import MAD_TO_SIGMA

STEP_M, MOST_ASIDE_RAD = 0.5, float(np.deg2rad(20.0))
WANDER_STEPS = 40  # 20 m: heading noise adds up over longer distances
FEWEST_STEPS = 20
ROUNDS, OUTLIER_SIGMAS, RIDGE = 5, 3.0, 1e-9
# In sound drives (simulated, analytic and KITTI's) both are at most 0.4°.
YAW_BIAS_RAD, PITCH_BIAS_RAD = float(np.deg2rad(0.6)), float(np.deg2rad(1.0))
SURE_TIMES, UNSTEADY_RAD = 4.0, float(np.deg2rad(4.0))


Array = NDArray[np.float64]


@dataclass(frozen=True)
class DrivingDirection:
    """Over `steps`: yaw and pitch of straight driving relative to the robot's x, and their errors, in rad.

    `aside_m` is the sideways drift of the poses: one standard deviation about a straight drift over 20 m (the median of
    such stretches), or 0 without such a stretch.
    """

    steps: int
    yaw_rad: float
    yaw_error_rad: float
    pitch_rad: float
    pitch_error_rad: float
    aside_m: float = 0.0

    @property
    def is_yawed(self) -> bool:
        """Whether the heading bias exceeds that of sound runs."""
        return abs(self.yaw_rad) > max(YAW_BIAS_RAD, SURE_TIMES * self.yaw_error_rad)

    @property
    def is_pitched(self) -> bool:
        """Whether the pitch bias exceeds that of sound runs."""
        return abs(self.pitch_rad) > max(PITCH_BIAS_RAD, SURE_TIMES * self.pitch_error_rad)


def turned_to_way(calibration: Calibration, yaw_rad: float, pitch_rad: float) -> tuple[Mount, ...]:
    """Return the INS mounts that turn a way `yaw_rad` to the left of x and `pitch_rad` above it to x; positions
    stay.
    """
    way = np.array([np.cos(pitch_rad) * np.cos(yaw_rad), np.cos(pitch_rad) * np.sin(yaw_rad), np.sin(pitch_rad)])
    half = np.array([1.0 + way[0], 0.0, way[2], -way[1]])  # the shortest rotation of the way to x
    mounts = []
    for mount in calibration.of_kind("ins"):
        placed = calibration.ego_from_lidar @ mount.lidar_from_sensor
        turned = SE3.from_parts(multiply(half, placed.wxyz), placed.translation_m)
        mounts.append(replace(mount, lidar_from_sensor=calibration.ego_from_lidar.inverse() @ turned))
    return tuple(mounts)


def driving_direction(track: Trajectory) -> DrivingDirection | None:
    """Return the direction of a track's steps; None for fewer than `FEWEST_STEPS`, or if the scatter shows a robot that
    drives in any direction.
    """
    parts = [_steps(track.map_from_ego[rows]) for rows in _stretches(track.segments)]
    steps = np.concatenate([np.zeros((0, 4)), *parts])
    if len(steps) < FEWEST_STEPS:
        return None
    (yaw, yaw_error, yaw_spread), (pitch, pitch_error, pitch_spread) = (
        _straight_on(steps[:, column], steps[:, 2 + column]) for column in (0, 1)
    )
    if max(yaw_spread, pitch_spread) > UNSTEADY_RAD:
        return None
    off_rad = [part[:, 0] - yaw[0] - yaw[1] * part[:, 2] for part in parts]
    return DrivingDirection(len(steps), float(yaw[0]), yaw_error, float(pitch[0]), pitch_error, _aside_m(off_rad))


def _aside_m(off_rad: list[Array]) -> float:
    """Return the sideways drift of stretches of `WANDER_STEPS` steps with these direction errors (S,)."""
    deviations, way = [], np.arange(WANDER_STEPS + 1.0)
    for off in off_rad:
        for begin in range(0, len(off) - WANDER_STEPS + 1, WANDER_STEPS):
            aside_m = np.append(0.0, STEP_M * np.cumsum(off[begin : begin + WANDER_STEPS]))
            deviations.append(float(np.std(aside_m - np.polyval(np.polyfit(way, aside_m, 1), way))))
    return float(np.median(deviations)) if deviations else 0.0


def _straight_on(angles_rad: Array, turns: Array) -> tuple[Array, float, float]:
    """Return the line of the angles (S,) over the turn (S,) as (angle without turn, slope), the error of that angle,
    and the spread about the line.

    The ego origin of a steering robot need not be its centre of rotation; it then slides sideways in proportion.
    """
    design = np.column_stack([np.ones_like(turns), turns])
    kept = np.ones(len(turns), np.bool_)
    for _ in range(ROUNDS):
        line = np.linalg.lstsq(design[kept], angles_rad[kept], rcond=None)[0]
        off = np.abs(angles_rad - design @ line)
        spread = MAD_TO_SIGMA * float(np.median(off))
        kept = off <= OUTLIER_SIGMAS * max(spread, 1e-9)
    weight = np.linalg.pinv(design[kept].T @ design[kept] + RIDGE * np.eye(2))
    return np.asarray(line, np.float64), spread * float(np.sqrt(weight[0, 0])), spread


def _stretches(segments: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return [np.flatnonzero(segments == segment) for segment in np.unique(segments).tolist()]


def _steps(poses: SE3) -> Array:
    """Return yaw and pitch (S, 2) of one stretch's steps relative to the pose midway, and the turn of each per
    metre.
    """
    lengths_m = np.linalg.norm(np.diff(poses.translation_m, axis=0), axis=1)
    marks = np.floor(np.concatenate([[0.0], np.cumsum(lengths_m)]) / STEP_M)
    rows = np.flatnonzero(np.append(True, np.diff(marks) > 0)[: len(marks)])
    if len(rows) < 2:
        return np.zeros((0, 4))
    begin, end = rows[:-1], rows[1:]
    way = poses.translation_m[end] - poses.translation_m[begin]
    x, y, z = np.einsum("nij,nj->in", poses[(begin + end) // 2].inverse().as_matrix()[:, :3, :3], way)
    forward = (poses[begin].inverse() @ poses[end]).as_matrix()[:, :3, 0]
    angles = np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
    turns = np.column_stack([np.arctan2(forward[:, 1], forward[:, 0]), np.arcsin(np.clip(forward[:, 2], -1.0, 1.0))])
    is_ahead = np.abs(angles).max(axis=1) < MOST_ASIDE_RAD
    return np.compress(is_ahead, np.column_stack([angles, turns / np.linalg.norm(way, axis=1)[:, None]]), axis=0)
