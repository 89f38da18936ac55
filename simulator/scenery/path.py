"""The robot's path: a meandering line in plan, then exact poses on the ground at 200 Hz.

**Conventions.** The world frame is the map: x along the valley, y left, z up, metres. Between two samples the exact
pose is `stone.geometry.se3.interpolate` of them; sensors and truth use the same rule, so the truth has no interpolation
error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from simulator.scenery.terrain import Terrain
from stone.geometry.se3 import SE3, Array, interpolate
from stone.sensors.calibration import Footprint

SPEED_SWING_RATIO = 0.15
POSE_NS = 5_000_000
SUSPENSION_SAMPLES = 12  # 60 ms of smoothing at 200 Hz
TRACK_STEP_M = 0.05


@dataclass(frozen=True, eq=False)
class PlannedLine:
    """The line in plan: (K, 2) points every `TRACK_STEP_M` of arc, with headings (K,)."""

    points_m: Array
    heading_rad: Array


@dataclass(frozen=True, eq=False)
class DriveTrajectory:
    """Exact poses: `map_from_ego` at `start_ns + k · POSE_NS`."""

    start_ns: int
    map_from_ego: SE3

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        return self.start_ns + POSE_NS * np.arange(len(self.map_from_ego), dtype=np.int64)

    def at(self, stamps_ns: NDArray[np.int64]) -> SE3:
        """Return the poses at these stamps (N,); stamps outside the run take the nearest end."""
        last = len(self.map_from_ego) - 1
        elapsed = np.clip(stamps_ns - self.start_ns, 0, last * POSE_NS)
        index = np.minimum(elapsed // POSE_NS, last - 1)
        ratio = (elapsed - index * POSE_NS) / POSE_NS
        return interpolate(self.map_from_ego[index], self.map_from_ego[index + 1], ratio)


def plan_track(length_m: float, start_m: tuple[float, float], rng: np.random.Generator) -> PlannedLine:
    """Return a meandering line: the heading is a sum of two waves around +x, so arc length and curvature are known."""
    arc = np.arange(0.0, length_m, TRACK_STEP_M)
    phases = rng.uniform(0, 2 * np.pi, 2)
    heading = 0.55 * np.sin(2 * np.pi * arc / 47.0 + phases[0]) + 0.3 * np.sin(2 * np.pi * arc / 19.0 + phases[1])
    steps = TRACK_STEP_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
    points[:, 1] -= (points[:, 1].max() + points[:, 1].min()) / 2
    return PlannedLine(points + np.asarray(start_m), heading)


def driven_m(speed_m_s: float, count: int) -> Array:
    """Return the metres driven by each of `count` poses, at this average speed, which varies with a period of 8 s."""
    time_s = np.arange(count) * POSE_NS * 1e-9
    swing = SPEED_SWING_RATIO * 8.0 / (2 * np.pi) * (1 - np.cos(2 * np.pi * time_s / 8.0))
    return np.asarray(speed_m_s * (time_s + swing))


def drive(track: PlannedLine, terrain: Terrain, start_ns: int, driven: Array) -> DriveTrajectory:
    """Return a pose for each driven distance (N,): the plane of the ground below, smoothed by springs."""
    arc = np.minimum(driven, (len(track.heading_rad) - 1) * TRACK_STEP_M)
    grid = np.arange(len(track.heading_rad)) * TRACK_STEP_M
    x, y = (np.interp(arc, grid, track.points_m[:, axis]) for axis in (0, 1))
    heading = np.interp(arc, grid, track.heading_rad)
    planes = gaussian_filter1d(_ground_planes(terrain, x, y, heading), SUSPENSION_SAMPLES, axis=0, mode="nearest")
    return DriveTrajectory(start_ns, _poses_on_ground(x, y, heading, planes))


def _ground_planes(terrain: Terrain, x: Array, y: Array, heading: Array) -> Array:
    """Return the least-squares planes z = a·forward + b·left + c over the footprint, (N, 3)."""
    footprint = Footprint()
    half = np.linspace(-0.5, 0.5, 5)
    forward, left = (g.ravel() for g in np.meshgrid(half * footprint.length_m, half * footprint.width_m))
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    z = terrain.elevation_m(np.stack([x[:, None] + c * forward - s * left, y[:, None] + s * forward + c * left], -1))
    solver = np.linalg.pinv(np.stack([forward, left, np.ones_like(forward)], axis=-1))
    return np.asarray(z @ solver.T)


def _poses_on_ground(x: Array, y: Array, heading: Array, planes: Array) -> SE3:
    c, s = np.cos(heading), np.sin(heading)
    forward = np.stack([c, s, planes[:, 0]], axis=-1)
    left = np.stack([-s, c, planes[:, 1]], axis=-1)
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    up = np.cross(forward, left)
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    matrix = np.zeros((len(x), 4, 4))
    matrix[:, :3, 0], matrix[:, :3, 1], matrix[:, :3, 2] = forward, np.cross(up, forward), up
    matrix[:, :3, 3] = np.stack([x, y, planes[:, 2]], axis=-1)
    matrix[:, 3, 3] = 1.0
    return SE3.from_matrix(matrix)
