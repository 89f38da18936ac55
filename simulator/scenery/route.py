"""Routes of what moves: along the robot's own track, earlier or later than it, slower, faster or the other way.

**Conventions.** Where a mover is follows from time alone, in world coordinates. A schedule says which moment of the
robot's drive a mover has reached; before its beginning and beyond its end the track goes straight on.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulator.scenery.path import DriveTrajectory
from stone.geometry.se3 import Array

S_NS = 1_000_000_000
END_STEP_NS = 100_000_000  # of the track, by whose direction and length it goes on


class WalkableGround(Protocol):
    """What is moved on: the terrain of a simulation, or the truth about it."""

    def elevation_m(self, xy: Array) -> Array: ...


@dataclass(frozen=True)
class Schedule:
    """After t seconds the place is reached where the robot is after `from_s` + `times` · t, up to `until_s`."""

    from_s: float
    times: float = 1.0
    until_s: float | None = None

    def reached_ns(self, elapsed_ns: int) -> int:
        """Of the robot's drive, for a time since its beginning."""
        reached_ns = round(self.from_s * S_NS) + round(self.times * elapsed_ns)
        if self.until_s is None:
            return reached_ns
        until_ns = round(self.until_s * S_NS)
        return min(reached_ns, until_ns) if self.times > 0 else max(reached_ns, until_ns)


@dataclass(frozen=True, eq=False)
class Route:
    """A schedule along the robot's track, so far to its left, swaying about that by `sway_m` in `sway_period_ns`."""

    trajectory: DriveTrajectory
    ground: WalkableGround
    schedule: Schedule
    aside_m: float = 0.0
    sway_m: float = 0.0
    sway_period_ns: int = 8 * S_NS

    def at(self, stamp_ns: int) -> tuple[Array, float]:
        """The place on the ground (3,) and the heading of the track there (rad)."""
        elapsed_ns = stamp_ns - self.trajectory.start_ns
        reached_ns = self.schedule.reached_ns(elapsed_ns)
        last_ns = int(self.trajectory.stamps_ns[-1]) - self.trajectory.start_ns
        within_ns = min(max(reached_ns, 0), last_ns)
        pose = self.trajectory.at(np.array([self.trajectory.start_ns + within_ns]))
        aside_m = self.aside_m + self.sway_m * np.sin(2 * np.pi * elapsed_ns / self.sway_period_ns)
        beyond_m = 0.0 if within_ns == reached_ns else self._beyond_m(reached_ns - within_ns, last_ns)
        xy = (pose @ np.array([[beyond_m, aside_m, 0.0]]))[:, :2]
        forward = pose.rotation()[0, :, 0]
        return np.append(xy[0], self.ground.elevation_m(xy)), float(np.arctan2(forward[1], forward[0]))

    def is_standing(self, stamp_ns: int) -> bool:
        """Whether the schedule has reached where it ends."""
        return self.schedule.until_s is not None and (
            self.schedule.reached_ns(stamp_ns - self.trajectory.start_ns) == round(self.schedule.until_s * S_NS)
        )

    def _beyond_m(self, beyond_ns: int, last_ns: int) -> float:
        """How far straight on, at the speed at that end of the drive."""
        begin_ns = self.trajectory.start_ns + (0 if beyond_ns < 0 else last_ns - END_STEP_NS)
        ends = self.trajectory.at(np.array([begin_ns, begin_ns + END_STEP_NS])).translation_m
        return float(np.linalg.norm(ends[1] - ends[0])) * beyond_ns / END_STEP_NS
