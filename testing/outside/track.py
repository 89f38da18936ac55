"""The robot's track through an analytic world, and its attitude on the ground under its footprint.

**Conventions.** Poses are `world_from_ego` matrices (N, 4, 4); the ego origin lies on the ground below the LiDAR, x
forward. The track winds about the world's x axis: y = swing · sin(2π x / period).
"""

from dataclasses import dataclass

import numpy as np

from testing.outside.ground import Array, Ground, heights_m

LENGTH_M, WIDTH_M = 1.06, 0.85
SWING_M, PERIOD_M = 2.5, 30.0


@dataclass(frozen=True, eq=False)
class Track:
    """A drive of `seconds` with `speed_m_s` along x; the track continues beyond both ends."""

    ground: Ground
    seconds: float
    speed_m_s: float = 1.8

    def plan(self, x: Array) -> Array:
        """Return the points (N, 2) of the track at these x, metres."""
        return np.stack([x, SWING_M * np.sin(2 * np.pi * x / PERIOD_M)], axis=-1)

    def beside(self, x: float, left_m: float) -> tuple[float, float]:
        """Return the point `left_m` to the left of the track's point at x."""
        yaw = float(_yaw(np.array(x)))
        point = self.plan(np.array(x))
        return float(point[0] - left_m * np.sin(yaw)), float(point[1] + left_m * np.cos(yaw))

    def yaw_at(self, x: float) -> float:
        """Return the direction of the track at x, rad."""
        return float(_yaw(np.array(x)))

    def poses(self, seconds: Array) -> Array:
        """Return the exact poses (N, 4, 4) after `seconds` (N,)."""
        x = np.asarray(seconds) * self.speed_m_s
        points, yaw = self.plan(x), _yaw(x)
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
        corners = [
            heights_m(self.ground, points + a * LENGTH_M / 2 * ahead + b * WIDTH_M / 2 * left)
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
        ]
        climb = (corners[0] + corners[1] - corners[2] - corners[3]) / 2 / LENGTH_M
        lean = (corners[0] + corners[2] - corners[1] - corners[3]) / 2 / WIDTH_M
        forward, sideways = (
            np.concatenate([axis, rise[:, None]], axis=1) for axis, rise in ((ahead, climb), (left, lean))
        )
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        up = np.cross(forward, sideways)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        poses = np.tile(np.eye(4), (len(x), 1, 1))
        poses[:, :3, :3] = np.stack([forward, np.cross(up, forward), up], axis=-1)
        poses[:, :3, 3] = np.concatenate([points, np.mean(corners, axis=0)[:, None]], axis=1)
        return poses


def _yaw(x: Array) -> Array:
    return np.asarray(np.arctan2(SWING_M * 2 * np.pi / PERIOD_M * np.cos(2 * np.pi * x / PERIOD_M), 1.0))
