"""The analytic worlds `hills`, `slopes` and `forest`: their ground, and their solids beside and on the robot's way.

**Conventions.** A solid is placed `left_m` to the left of the track's point at x. The walker crosses the track ahead of
the robot; during a sweep it stands at its position in the sweep's middle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from testing.outside.ground import Array, Ground, heights_m
from testing.outside.solids import BOX, CYLINDER, ELLIPSOID, GRASS, Kind, Solid, Solids, as_rows
from testing.outside.track import Track

# Amplitude m, length m, direction degrees: hills of about 8°, and unevenness below a wheel's size.
WAVES = ((0.50, 25.0, 20.0), (0.12, 11.0, 80.0), (0.012, 2.3, 140.0), (0.004, 0.7, 35.0))
GRASS_M, GRASS_PATH_M, BUSH_PATH_M, CROWN_PATH_M = 0.3, 0.6, 0.25, 0.6
WALKER_RADIUS_M, WALKER_M, WALKER_SPEED_M_S = 0.25, 1.75, 1.2


@dataclass(frozen=True)
class Layout:
    """The solids at (x, left) of the track, metres; `hills` scales the long waves."""

    hills: float
    mounds: tuple[tuple[float, float], ...] = ()
    ditches: tuple[tuple[float, float], ...] = ()
    banks: tuple[tuple[float, float], ...] = ()
    grass: tuple[tuple[float, float, float], ...] = ()  # with their radius
    trees: tuple[tuple[float, float], ...] = ()
    bushes: tuple[tuple[float, float], ...] = ()
    walls: tuple[tuple[float, float], ...] = ()
    bars: tuple[tuple[float, float], ...] = ()
    roofs: tuple[tuple[float, float], ...] = ()
    people: tuple[tuple[float, float], ...] = ()
    rocks: tuple[tuple[float, float, float], ...] = field(default=())  # with their height


LAYOUTS: Mapping[str, Layout] = {
    "hills": Layout(
        hills=1.0,
        banks=((14.0, -2.2),),
        grass=((9.0, 0.3, 2.2), (18.0, 4.5, 2.0)),
        trees=((4.0, 2.0), (12.5, 2.6), (22.0, -1.9), (6.0, -6.0), (17.0, 8.5), (25.0, 5.0)),
        bushes=((6.5, 1.8), (20.0, 2.2), (3.0, -3.5), (24.0, -4.5)),
        walls=((7.5, -3.2), (21.0, 6.8)),
        bars=((16.0, 2.4), (10.5, 6.0)),
        roofs=((23.5, 0.0),),
        people=((19.0, -2.5),),
        rocks=((2.5, 1.3, 0.35), (5.0, -1.6, 0.25), (11.5, -1.5, 0.45), (15.0, 1.3, 0.3), (18.5, -1.4, 0.15),
               (20.5, -3.0, 0.5), (8.0, 4.0, 0.3), (13.5, 4.5, 0.12)),
    ),
    "slopes": Layout(
        hills=0.7,
        mounds=((8.0, 9.3), (22.0, -9.6)),
        ditches=((19.0, 3.2), (6.0, -4.2)),
        banks=((12.0, -2.4),),
        grass=((13.5, -0.4, 2.0), (4.0, 3.5, 1.5), (24.0, 4.5, 2.0)),
        trees=((2.5, -2.0), (16.0, -3.5)),
        bushes=((10.0, -4.5), (25.5, 1.9)),
        walls=((16.0, 6.5),),
        bars=((3.0, 2.2),),
        people=((26.0, -2.4),),
        rocks=((5.0, 1.4, 0.3), (9.5, -1.4, 0.25), (11.0, 1.5, 0.4), (17.0, -1.3, 0.3), (20.5, -1.5, 0.5),
               (23.0, 1.3, 0.15), (15.0, 3.0, 0.25)),
    ),
    "forest": Layout(
        hills=0.6,
        grass=((6.0, 0.5, 2.5), (17.0, -0.2, 1.8), (12.0, 5.0, 1.5)),
        trees=((1.5, 1.6), (3.0, -2.4), (5.5, 3.6), (7.5, -1.7), (9.0, 2.1), (11.0, -3.3), (12.5, 1.8), (14.0, -1.8),
               (16.5, 3.0), (18.5, -2.7), (20.0, 1.7), (22.0, -1.6), (23.5, 3.3), (25.5, -2.5), (4.0, -7.0),
               (10.0, 7.5), (15.0, -6.5), (21.0, 6.5), (26.0, 6.0), (19.0, -7.0)),
        bushes=((4.2, 1.7), (10.2, -1.9), (15.4, 1.6), (19.2, 4.0), (24.5, 1.7), (13.0, -4.8)),
        walls=((22.5, 5.0),),
        bars=((8.2, 3.6), (21.2, -3.2)),
        roofs=((13.2, 0.0),),
        people=((17.8, 2.4),),
        rocks=((2.4, -1.2, 0.25), (6.5, -1.5, 0.35), (11.8, -1.3, 0.3), (18.0, 1.3, 0.22), (23.0, -1.3, 0.4),
               (16.0, -4.0, 0.3)),
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class World:
    """An analytic world, its drive, and time and position (x) of the walker's crossing."""

    name: str
    ground: Ground
    solids: Solids
    track: Track
    walker_x_m: float

    def walker(self, seconds: float) -> Solids:
        """Return the walker's row at this time."""
        x, y = self.walker_at(np.array([seconds]))[0]
        foot = float(heights_m(self.ground, np.array([x, y])))
        centre = (float(x), float(y), foot + WALKER_M / 2)
        return as_rows([Solid("person", CYLINDER, centre, (WALKER_RADIUS_M, WALKER_RADIUS_M, WALKER_M / 2))])

    def walker_at(self, seconds: Array) -> Array:
        """Return the walker's positions (N, 2); half way through, the robot is 6 m short of its crossing."""
        crossing = (self.walker_x_m - 6.0) / self.track.speed_m_s
        left_m = 6.0 - (np.asarray(seconds) - crossing + 5.0) * WALKER_SPEED_M_S
        return np.array([self.track.beside(self.walker_x_m, distance) for distance in left_m.tolist()])

    def all_solids(self, seconds: float) -> Solids:
        """Return every solid, the walker last."""
        return np.concatenate([self.solids, self.walker(seconds)])


def world_of(name: str, seed: int = 1, seconds: float = 15.0) -> World:
    """Return the world of this name; the seed moves its waves and, by decimetres, its solids."""
    layout, rng = LAYOUTS[name], np.random.default_rng([seed, len(name), ord(name[0])])
    ground = _ground(layout, rng)
    track = Track(ground, seconds)
    return World(name, ground, as_rows(_Planting(track, rng).all_of(layout)), track, walker_x_m=12.0)


def _ground(layout: Layout, rng: np.random.Generator) -> Ground:
    waves = []
    for amplitude, length, degrees in WAVES:
        turned, k = np.deg2rad(degrees) + rng.uniform(-0.3, 0.3), 2 * np.pi / length
        scale = layout.hills if length > 5 else 1.0
        waves.append((scale * amplitude, k * np.cos(turned), k * np.sin(turned), rng.uniform(0, 2 * np.pi)))
    flat = Track(Ground(np.zeros((0, 4)), np.zeros((0, 2)), np.zeros((0, 7)), np.zeros((0, 6))), 0.0)
    mounds = [flat.beside(*spot) for spot in layout.mounds]
    ditches = [(*flat.beside(x, left), flat.yaw_at(x), 4.0, 0.7, 0.3, 1.0) for x, left in layout.ditches]
    # A bank rises away from the track, on either side.
    banks = [
        (*flat.beside(x, left), flat.yaw_at(x) + (np.pi if left < 0 else 0.0), 3.5, 0.3, 4.0)
        for x, left in layout.banks
    ]
    return Ground(
        *(np.array(rows, float).reshape(-1, n) for rows, n in ((waves, 4), (mounds, 2), (ditches, 7), (banks, 6)))
    )


@dataclass(frozen=True, eq=False)
class _Planting:
    """The placement of solids on the ground beside the track."""

    track: Track
    rng: np.random.Generator

    def all_of(self, layout: Layout) -> list[Solid]:
        """Return every solid of a layout."""
        solids = [self._grass(*sized) for sized in layout.grass]
        for spot in layout.trees:
            solids += self._tree(*spot)
        for spot in layout.bars:
            solids += self._bar(*spot)
        solids += [self._bush(*spot) for spot in layout.bushes]
        solids += [self._rock(*sized) for sized in layout.rocks]
        solids += [self._block("wall", spot, (2.5, 0.15, 0.75), 0.75) for spot in layout.walls]
        solids += [self._block("roof", spot, (1.5, 2.5, 0.1), 2.8) for spot in layout.roofs]
        return solids + [self._upright("person", spot, 0.25, 1.75) for spot in layout.people]

    def _at(self, spot: tuple[float, float]) -> tuple[float, float, float]:
        """Return the ground point at (x, left), moved by up to 0.1 m away from the track."""
        x, left_m = spot
        px, py = self.track.beside(x, left_m + np.sign(left_m) * self.rng.uniform(0, 0.1))
        return px, py, float(heights_m(self.track.ground, np.array([px, py])))

    def _upright(self, kind: Kind, spot: tuple[float, float], radius_m: float, top_m: float) -> Solid:
        px, py, foot = self._at(spot)
        return Solid(kind, CYLINDER, (px, py, foot + top_m / 2 - 0.2), (radius_m, radius_m, top_m / 2 + 0.2))

    def _tree(self, x: float, left_m: float) -> list[Solid]:
        trunk = self._upright("trunk", (x, left_m), float(self.rng.uniform(0.1, 0.2)), 4.0)
        px, py, middle = trunk.centre_m
        crown = (px, py, middle - 1.8 + 4.2)  # its lowest leaf is 2.7 m above the ground
        return [trunk, Solid("crown", ELLIPSOID, crown, (1.6, 1.6, 1.5), free_path_m=CROWN_PATH_M)]

    def _bush(self, x: float, left_m: float) -> Solid:
        px, py, foot = self._at((x, left_m))
        half = tuple(self.rng.uniform(0.4, 0.6, 3))
        return Solid("bush", ELLIPSOID, (px, py, foot + 0.35), half, free_path_m=BUSH_PATH_M)

    def _rock(self, x: float, left_m: float, height_m: float) -> Solid:
        px, py, foot = self._at((x, left_m))
        kind: Kind = "rock" if height_m > 0.2 else "small rock"
        wide = height_m * self.rng.uniform(0.6, 0.9, 2)
        return Solid(kind, ELLIPSOID, (px, py, foot + 0.1 * height_m), (wide[0], wide[1], 0.9 * height_m))

    def _block(
        self, kind: Kind, spot: tuple[float, float], half_m: tuple[float, float, float], middle_m: float
    ) -> Solid:
        px, py, foot = self._at(spot)
        sunk = (half_m[0], half_m[1], half_m[2] + (0.3 if kind == "wall" else 0.0))
        return Solid(kind, BOX, (px, py, foot + middle_m), sunk, self.track.yaw_at(spot[0]))

    def _bar(self, x: float, left_m: float) -> list[Solid]:
        """Return a bar 0.5 to 0.9 m above the ground at its middle, along the track, on two posts."""
        px, py, foot = self._at((x, left_m))
        yaw = self.track.yaw_at(x)
        bar = Solid("bar", BOX, (px, py, foot + 0.7), (1.0, 0.06, 0.1), yaw)
        posts = []
        for end in (-1.0, 1.0):
            ex, ey = px + end * np.cos(yaw), py + end * np.sin(yaw)
            ground = float(heights_m(self.track.ground, np.array([ex, ey])))
            posts.append(Solid("post", CYLINDER, (ex, ey, ground + 0.4), (0.05, 0.05, 0.6)))
        return [bar, *posts]

    def _grass(self, x: float, left_m: float, radius_m: float) -> Solid:
        px, py, foot = self._at((x, left_m))
        return Solid("grass", GRASS, (px, py, foot), (radius_m, radius_m, GRASS_M / 2), free_path_m=GRASS_PATH_M)
