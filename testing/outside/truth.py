"""The truth of an analytic world: drivable ground, obstacles, and grey places that count as neither.

**Conventions.** Ground is drivable if its plane over the disc of `FOOTPRINT_M` is no steeper than `DRIVABLE_DEG` and
nowhere farther than `STEP_M` from the ground. A solid over it at up to `ROBOT_M` makes it undrivable, except grass.
Obstacles are ground that is steeper than `OBSTACLE_DEG` within `FACE_M`, and every solid that is not `HARMLESS`.

A point is judged by its column and its height above the ground. It is ground within `BAND_M` (in grass up to its tips),
and a solid within `TOUCH_M` of its surface from `FOOT_M` up to `ROBOT_M`. All other points are grey.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from testing.outside.ground import Array, along, heights_m
from testing.outside.solids import HARMLESS, KINDS, outside_m
from testing.outside.worlds import GRASS_M, WALKER_M, WALKER_RADIUS_M, World

AIR, DRIVABLE, OBSTACLE, GREY = 0, 1, 2, 3
DRIVABLE_DEG, OBSTACLE_DEG, STEP_M, ROBOT_M = 20.0, 25.0, 0.12, 1.5
FOOTPRINT_M, FACE_M = 0.5, 0.15
BAND_M, TOUCH_M, NEAR_M, FOOT_M = 0.25, 0.1, 0.35, 0.1
CELL_M, REACH_M = 0.1, 37.0  # a label grid's corner is 36.2 m from its middle
SLOPE_BANDS_DEG = (0.0, 10.0, 15.0, 20.0, 25.0, 35.0, 90.0)
SLOPES = ("hill", "mound", "ditch", "bank")  # the parts that steep ground belongs to
Codes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Judged:
    """For points (N,): the code, the thing that an obstacle is (-1: none), and the slope of open ground (NaN: none).

    The first numbers of things are the solids, then the parts of the ground, as in `Truth.things`.
    """

    codes: Codes
    things: NDArray[np.int64]
    slope_deg: Array


class Truth:
    """Lattices of `CELL_M` over the plan within `REACH_M` of the track: slope, step, drivable and steep cells."""

    def __init__(self, world: World) -> None:
        self.world = world
        way = world.track.poses(np.linspace(0, world.track.seconds, 400))[:, :2, 3]
        self.low_m = way.min(axis=0) - REACH_M
        shape = np.ceil((way.max(axis=0) + REACH_M - self.low_m) / CELL_M).astype(int)
        self.xy = np.stack(np.meshgrid(*(np.arange(n) * CELL_M for n in shape), indexing="ij"), axis=-1) + self.low_m
        height = heights_m(world.ground, self.xy)
        self.slope_deg, self.step_m = plane_over(height, FOOTPRINT_M)
        self.face_deg, _ = plane_over(height, FACE_M)
        self.ground_things, names = _ground_things(world, self.xy)
        self.things = (*(KINDS[kind] for kind in world.solids["kind"]), *names)
        self.is_grass, self.is_blocked = np.zeros(shape, bool), np.zeros(shape, bool)
        self._lay_solids(height)
        self.is_steep = self.face_deg > OBSTACLE_DEG
        self.is_drivable = (
            (self.slope_deg <= DRIVABLE_DEG) & (self.step_m <= STEP_M) & ~self.is_blocked & ~self.is_steep
        )

    def _lay_solids(self, height: Array) -> None:
        for row in self.world.solids:
            reach = float(np.hypot(*row["half_m"][:2])) + NEAR_M
            low, high = (np.array(self.cells(row["centre_m"][None, :2] + side * reach)).ravel() for side in (-1, 1))
            window = (slice(low[0], high[0] + 1), slice(low[1], high[1] + 1))
            plan, ground = self.xy[window].reshape(-1, 2), height[window].reshape(-1)
            if KINDS[row["kind"]] == "grass":
                inside = np.linalg.norm(plan - row["centre_m"][:2], axis=1) <= row["half_m"][0]
                self.is_grass[window] |= inside.reshape(self.is_grass[window].shape)
                continue
            for above_m in np.arange(0.0, ROBOT_M + 0.01, 0.1):
                near = outside_m(np.column_stack([plan, ground + above_m]), row) < NEAR_M
                self.is_blocked[window] |= near.reshape(self.is_blocked[window].shape)

    def cells(self, xy: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the lattice indices (N,) of points (N, 2), clipped to the border."""
        index = np.rint((xy - self.low_m) / CELL_M).astype(np.int64)
        i, j = np.clip(index, 0, np.array(self.slope_deg.shape) - 1).T
        return i, j

    def judge(self, points: Array) -> Judged:
        """Judge points (N, 3) of the world."""
        i, j = self.cells(points[:, :2])
        above = (points[:, 2] - heights_m(self.world.ground, points[:, :2])) * np.cos(np.deg2rad(self.face_deg[i, j]))
        tips = np.where(self.is_grass[i, j], GRASS_M + 0.1, 0.0)
        is_ground = (above >= -BAND_M) & (above <= np.maximum(tips, BAND_M))
        steep, drivable = self.is_steep[i, j], self.is_drivable[i, j]
        codes = np.where(is_ground, np.where(drivable, DRIVABLE, np.where(steep, OBSTACLE, GREY)), AIR).astype(np.uint8)
        things = np.where(is_ground & steep, self.ground_things[i, j], -1)
        slope = np.where(is_ground & ~self.is_blocked[i, j], self.slope_deg[i, j], np.nan)
        for number, row in enumerate(self.world.solids):
            self._judge_solid(points, above, (number, row), codes, things)
        return Judged(codes, things, slope)

    def _judge_solid(
        self, points: Array, above: Array, solid: tuple[int, np.void], codes: Codes, things: NDArray[np.int64]
    ) -> None:
        number, row = solid
        if KINDS[row["kind"]] == "grass":
            return
        reach = np.append(np.full(2, np.hypot(*row["half_m"][:2])), row["half_m"][2]) + 0.5
        near = np.flatnonzero(np.abs(points[:, 0] - row["centre_m"][0]) <= reach[0])
        near = near[(np.abs(points[near] - row["centre_m"]) <= reach).all(axis=1)]
        away = outside_m(points[near], row)
        codes[near[(away < NEAR_M) & (codes[near] != OBSTACLE)]] = GREY
        hit = near[(away <= TOUCH_M) & (above[near] >= FOOT_M) & (above[near] <= ROBOT_M)]
        if KINDS[row["kind"]] not in HARMLESS:
            codes[hit], things[hit] = OBSTACLE, number

    def in_walkers_way(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of points (N, 3) that only the walker occupied: above 0.5 m, with nothing else near."""
        feet = self.world.walker_at(np.arange(0, self.world.track.seconds, 0.05))
        away = np.min(np.linalg.norm(points[:, None, :2] - feet[None], axis=2), axis=1)
        above = points[:, 2] - heights_m(self.world.ground, points[:, :2])
        return np.asarray((away <= WALKER_RADIUS_M + 0.1) & (above > 0.5) & (above < WALKER_M))


def plane_over(height: Array, radius_m: float) -> tuple[Array, Array]:
    """Return the slope in degrees of the least-squares plane over the disc around each cell, and its worst residual."""
    reach = round(radius_m / CELL_M)
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1] * CELL_M
    disc = np.hypot(i, j) <= radius_m + 1e-9
    weight = float((i[disc] ** 2).sum())
    gx, gy = (convolve(height, (axis * disc / weight)[::-1, ::-1], mode="nearest") for axis in (i, j))
    middle = convolve(height, disc / disc.sum(), mode="nearest")
    worst = np.zeros_like(height)
    for di, dj in zip(*np.nonzero(disc), strict=True):
        shifted = np.roll(height, (reach - di, reach - dj), axis=(0, 1))
        worst = np.maximum(worst, np.abs(shifted - middle - gx * i[di, dj] - gy * j[di, dj]))
    return np.rad2deg(np.arctan(np.hypot(gx, gy))), worst


def _ground_things(world: World, xy: Array) -> tuple[NDArray[np.int64], list[str]]:
    """Return the ground part of each cell, numbered after the solids, and the names of the parts."""
    first, names, things = len(world.solids), ["hill"], np.full(xy.shape[:2], len(world.solids), np.int64)
    for x, y in world.ground.mounds:
        things[np.hypot(xy[..., 0] - x, xy[..., 1] - y) < 8.2] = first + len(names)
        names.append("mound")
    for name, rows in (("ditch", world.ground.ditches), ("bank", world.ground.banks)):
        for row in rows:
            u, v = along(xy[..., 0], xy[..., 1], row)
            things[(np.abs(u) < row[3] + 0.2) & (np.abs(v) < 1.3)] = first + len(names)
            names.append(name)
    return things, names
