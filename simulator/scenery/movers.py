"""Movers in a simulated world: walkers and vehicles, each cast in closed form.

**Conventions.** A walker is an upright cylinder, a vehicle a level box above its wheels. In one sweep, or one exposure,
a mover stays at its position in the middle of the sweep.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.options import SimulateOptions
from simulator.scenery.objects import Surface
from simulator.scenery.path import DriveTrajectory
from stone.geometry.se3 import Array

# Routes of movers along the robot's own track: earlier or later, slower, faster or in the other direction. A mover's
# position depends only on time, in world coordinates. A schedule maps time to a moment of the robot's drive; before the
# drive's start and after its end the track continues straight.


S_NS = 1_000_000_000
END_STEP_NS = 100_000_000  # the piece at the end of the track that defines its direction and speed beyond


class WalkableGround(Protocol):
    """The ground below movers: the terrain of a simulation, or its ground truth."""

    def elevation_m(self, xy: Array) -> Array: ...


@dataclass(frozen=True)
class Schedule:
    """A schedule: after t seconds the mover is at the robot's position of `from_s` + `times` · t, up to `until_s`."""

    from_s: float
    times: float = 1.0
    until_s: float | None = None

    def reached_ns(self, elapsed_ns: int) -> int:
        """Return the moment of the robot's drive for a time since the start."""
        reached_ns = round(self.from_s * S_NS) + round(self.times * elapsed_ns)
        if self.until_s is None:
            return reached_ns
        until_ns = round(self.until_s * S_NS)
        return min(reached_ns, until_ns) if self.times > 0 else max(reached_ns, until_ns)


@dataclass(frozen=True, eq=False)
class Route:
    """A schedule along the robot's track, offset to its left and swaying by `sway_m` in `sway_period_ns`."""

    trajectory: DriveTrajectory
    ground: WalkableGround
    schedule: Schedule
    aside_m: float = 0.0
    sway_m: float = 0.0
    sway_period_ns: int = 8 * S_NS

    def at(self, stamp_ns: int) -> tuple[Array, float]:
        """Return the position on the ground (3,) and the heading of the track there (rad)."""
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
        """Return whether the schedule has reached its end."""
        return self.schedule.until_s is not None and (
            self.schedule.reached_ns(stamp_ns - self.trajectory.start_ns) == round(self.schedule.until_s * S_NS)
        )

    def _beyond_m(self, beyond_ns: int, last_ns: int) -> float:
        """Return the distance straight beyond the drive, at the speed of that end."""
        begin_ns = self.trajectory.start_ns + (0 if beyond_ns < 0 else last_ns - END_STEP_NS)
        ends = self.trajectory.at(np.array([begin_ns, begin_ns + END_STEP_NS])).translation_m
        return float(np.linalg.norm(ends[1] - ends[0])) * beyond_ns / END_STEP_NS


WALKER_RADIUS_M, WALKER_HEIGHT_M = 0.25, 1.75
AHEAD_S = 5.0
SWAY_M = 2.5
VEHICLE_M = (4.2, 1.8)  # length, width
VEHICLE_BOTTOM_M, VEHICLE_TOP_M = 0.3, 1.6
MARGIN_M = 0.35  # margin of the rays that are tested against a mover

Rays = NDArray[np.float32]


class Mover(Protocol):
    """An object with one position at a time that occludes what is behind it."""

    @property
    def route(self) -> Route: ...

    @property
    def surface(self) -> Surface: ...

    @property
    def reach_m(self) -> float:
        """The radius in plan around its position, with a margin."""

    def ranges_m(self, stamp_ns: int, origins: Rays, directions: Rays) -> Rays:
        """Return the distance along unit rays (N, 3) from origins (N, 3) to it at that time, inf for misses."""

    def normals(self, points_map: Array, stamp_ns: int) -> Array:
        """Return the outward normals (N, 3) of its surface at points on it (N, 3) at that time, map frame."""

    def is_inside(self, points_map: Array, stamp_ns: int, margin_m: float) -> NDArray[np.bool_]:
        """Return which points (N, 3) are inside it, or nearer than `margin_m` to it along an axis, at that time."""


@dataclass(frozen=True, eq=False)
class Walker:
    """An upright cylinder on the ground."""

    route: Route
    surface: Surface = Surface.WALKER
    reach_m: float = WALKER_RADIUS_M + MARGIN_M

    def ranges_m(self, stamp_ns: int, origins: Rays, directions: Rays) -> Rays:
        return cylinder_range(self.route.at(stamp_ns)[0], origins, directions)

    def normals(self, points_map: Array, stamp_ns: int) -> Array:
        return (points_map - self.route.at(stamp_ns)[0]) * (1 / WALKER_RADIUS_M, 1 / WALKER_RADIUS_M, 0.0)

    def is_inside(self, points_map: Array, stamp_ns: int, margin_m: float) -> NDArray[np.bool_]:
        offset = points_map - self.route.at(stamp_ns)[0]
        is_beside = np.hypot(offset[:, 0], offset[:, 1]) <= WALKER_RADIUS_M + margin_m
        return np.asarray(is_beside & (offset[:, 2] >= -margin_m) & (offset[:, 2] <= WALKER_HEIGHT_M + margin_m))


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A level box above its wheels, along its route."""

    route: Route
    surface: Surface = Surface.VEHICLE
    reach_m: float = float(np.hypot(*VEHICLE_M)) / 2 + MARGIN_M

    def ranges_m(self, stamp_ns: int, origins: Rays, directions: Rays) -> Rays:
        own, ways = self._own(origins, stamp_ns), directions @ self._turn(stamp_ns).astype(np.float32)
        inverse = 1 / np.where(ways == 0, np.float32(1e-12), ways)
        low, high = (np.asarray(corner, np.float32) - own for corner in _vehicle_corners(0.0))
        near = np.minimum(low * inverse, high * inverse).max(axis=1)
        far = np.maximum(low * inverse, high * inverse).min(axis=1)
        return np.where((near < far) & (near > 0), near, np.inf).astype(np.float32)

    def normals(self, points_map: Array, stamp_ns: int) -> Array:
        low, high = _vehicle_corners(0.0)
        aside = (self._own(points_map, stamp_ns) - (low + high) / 2) / ((high - low) / 2)  # ±1 on the hit face
        face = np.argmax(np.abs(aside), axis=1)
        own = np.zeros_like(points_map)
        own[np.arange(len(own)), face] = np.sign(np.take_along_axis(aside, face[:, None], axis=1))[:, 0]
        return np.asarray(own @ self._turn(stamp_ns).T)

    def is_inside(self, points_map: Array, stamp_ns: int, margin_m: float) -> NDArray[np.bool_]:
        own = self._own(points_map, stamp_ns)
        low, high = _vehicle_corners(margin_m)
        return np.asarray(((own >= low) & (own <= high)).all(axis=1))

    def _own(self, points_map: NDArray[np.floating], stamp_ns: int) -> NDArray[np.floating]:
        """Return points (N, 3) in the vehicle's frame: x ahead, y left, z up from the ground."""
        position = self.route.at(stamp_ns)[0].astype(points_map.dtype)
        return (points_map - position) @ self._turn(stamp_ns).astype(points_map.dtype)

    def _turn(self, stamp_ns: int) -> Array:
        heading = self.route.at(stamp_ns)[1]
        c, s = np.cos(heading), np.sin(heading)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def walker_ahead(trajectory: DriveTrajectory, ground: WalkableGround) -> Walker:
    """Return a walker at the robot's position in five seconds, swaying across its track."""
    return Walker(Route(trajectory, ground, Schedule(AHEAD_S), sway_m=SWAY_M))


def movers_of(options: SimulateOptions, trajectory: DriveTrajectory, ground: WalkableGround) -> tuple[Mover, ...]:
    """Return the movers of these options, the walker ahead first."""
    if options.traffic == "none":
        return ()
    ahead = walker_ahead(trajectory, ground)
    return (ahead,) if options.traffic == "walker" else (ahead, *_traffic(trajectory, ground, options.seconds))


def _traffic(trajectory: DriveTrajectory, ground: WalkableGround, seconds: float) -> tuple[Mover, ...]:
    """Return two more walkers and two vehicles.

    One walker follows the robot, one comes towards it. One vehicle overtakes it on its left in the first half of the
    run; the other comes towards it on its right, parks half-way, and stays there.
    """

    def route(schedule: Schedule, aside_m: float) -> Route:
        return Route(trajectory, ground, schedule, aside_m)

    return (
        Walker(route(Schedule(-4.0), -1.5)),
        Walker(route(Schedule(seconds, -1.0), 2.0)),
        Vehicle(route(Schedule(-0.7 * seconds, 3.0), 4.0)),
        Vehicle(route(Schedule(1.2 * seconds, -1.5, 0.6 * seconds), -4.5)),
    )


def cylinder_range(foot_m: Array, origins: Rays, directions: Rays) -> Rays:
    """Return the distance along unit rays (N, 3) to a walker's side, inf for misses."""
    offset = foot_m[:2].astype(np.float32) - origins[:, :2]
    plan = directions[:, :2]
    a = np.maximum(np.einsum("ij,ij->i", plan, plan), 1e-12)
    b = np.einsum("ij,ij->i", plan, offset)
    disc = b * b - a * (np.einsum("ij,ij->i", offset, offset) - WALKER_RADIUS_M**2)
    reach = (b - np.sqrt(np.maximum(disc, 0))) / a
    z = origins[:, 2] + reach * directions[:, 2] - np.float32(foot_m[2])
    is_hit = (disc > 0) & (reach > 0) & (z > 0) & (z < WALKER_HEIGHT_M)
    return np.where(is_hit, reach, np.inf).astype(np.float32)


def _vehicle_corners(margin_m: float) -> tuple[Array, Array]:
    """Return the lowest and the highest corner (3,), on its own axes."""
    half = np.array([*VEHICLE_M, 0.0]) / 2 + margin_m
    low = np.array([-half[0], -half[1], VEHICLE_BOTTOM_M - margin_m])
    return low, np.array([half[0], half[1], VEHICLE_TOP_M + margin_m])
