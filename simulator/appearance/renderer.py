"""Ray casting of the cameras and shading of the hits in the chosen light.

**Conventions.** Rays are taken in pieces of `PIECE_RAYS`, from one camera or several, so that memory does not grow with
the images. A shade ray goes from each hit towards the beam; movers cast shade in closed form, as they occlude.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.appearance import materials
from simulator.appearance.lights import LIGHTS, Light
from simulator.appearance.materials import (
    GRAVEL,
    HEIGHT,
    ROCK,
    SOIL,
    TALL,
    Floats,
    GroundCover,
    Spots,
    build_ground_cover,
    plane_fractal,
    single,
    smooth_normals,
)
from simulator.options import SimulateOptions
from simulator.scenery.movers import Mover
from simulator.scenery.objects import Surface
from simulator.scenery.scene import Hits, Rays, RayScene, put_mover, rays_towards
from simulator.scenery.world import generator
from stone.geometry.se3 import Array

PIECE_RAYS = 1 << 17
CLEARANCE_M = 0.02


@dataclass(frozen=True, eq=False)
class View:
    """Rays of one or more cameras (N, 3), the angle between neighbours, the time of the movers, and the robot's lamps
    (L, 7): position, axis, strength.
    """

    origins: Rays
    directions: Rays
    pixel_rad: float
    stamp_ns: int
    lamps: Array

    def of(self, piece: slice) -> "View":
        """Return a slice of its rays."""
        return replace(self, origins=self.origins[piece], directions=self.directions[piece])


class Renderer:
    """A renderer, built once per recording."""

    def __init__(self, scene: RayScene, options: SimulateOptions) -> None:
        self.world = scene.world
        self._scene = scene
        self._light = LIGHTS[options.illumination]
        self._cover = build_ground_cover(scene.world.terrain, generator(options.seed, "cover"))

    def pixels(self, view: View) -> NDArray[np.uint8]:
        """Return the colours (N, 3) of a view."""
        begins = range(0, len(view.directions), PIECE_RAYS)
        return np.concatenate([self._pixels(view.of(slice(begin, begin + PIECE_RAYS))) for begin in begins])

    def _pixels(self, view: View) -> NDArray[np.uint8]:
        hits, foot_m = self._hits(view)
        seen = Seen(view.origins, view.directions, hits, self._shaded(view, hits), foot_m, view.pixel_rad)
        return pixels_of(seen, self._cover, self._light, view.lamps)

    def _hits(self, view: View) -> tuple[Hits, NDArray[np.float32]]:
        """Return the nearest hits, on movers with their own normals, and the ground height below a mover (N,), NaN
        elsewhere.
        """
        origins, directions = view.origins, view.directions
        hits = self._scene.cast(origins, directions)
        foot_m = np.full(len(directions), np.nan, np.float32)
        for mover in self.world.movers:
            position = mover.route.at(view.stamp_ns)[0]
            towards = rays_towards(position, mover.reach_m, origins, directions)
            met = put_mover(hits, mover, view.stamp_ns, (origins, directions), towards)
            points = origins[met] + directions[met] * hits.range_m[met, None]
            hits.normal[met] = mover.normals(points.astype(np.float64), view.stamp_ns)
            foot_m[met] = position[2]
        return hits, foot_m

    def _shaded(self, view: View, hits: Hits) -> NDArray[np.bool_]:
        """Return which rays (N,) hit a point that the beam does not reach."""
        is_shaded = np.zeros(len(hits.range_m), np.bool_)
        if not self._light.casts_shade:
            return is_shaded
        met = np.flatnonzero(np.isfinite(hits.range_m))
        towards = self._light.towards.astype(np.float32)
        directions = view.directions[met]
        side = np.where(
            np.isin(hits.surface[met], LEAVES)[:, None], -towards, directions
        )  # leaves do not shade themselves
        turn = -np.sign(np.einsum("ni,ni->n", hits.normal[met], side))
        points = view.origins[met] + directions * hits.range_m[met, None]
        points += CLEARANCE_M * (hits.normal[met] * turn[:, None] + towards)
        is_shaded[met] = self._scene.is_hidden(points, towards)
        for mover in self.world.movers:
            near = _may_shade(mover, self._light, view.stamp_ns, points)
            ways = np.repeat(towards[None], len(near), axis=0)
            is_shaded[met[near]] |= np.isfinite(mover.ranges_m(view.stamp_ns, points[near], ways))
        return is_shaded


def _may_shade(mover: Mover, light: Light, stamp_ns: int, points: Rays) -> NDArray[np.int64]:
    """Return the indices of the points whose path to the light passes near a mover, in plan."""
    ahead = light.towards[:2] / np.linalg.norm(light.towards[:2])
    offset = mover.route.at(stamp_ns)[0][:2].astype(np.float32) - points[:, :2]
    along, across = (offset @ way.astype(np.float32) for way in (ahead, np.array([-ahead[1], ahead[0]])))
    return np.flatnonzero((along > -mover.reach_m) & (np.abs(across) < mover.reach_m))


# Pixels from hits: the surface's colour, lit by beam, sky and lamps, through haze, with the camera's exposure. Arrays
# are of rays: directions and normals (N, 3) float32 in the map frame, ranges (N,) in metres, inf for the sky. Light is
# linear until `shown`, which saturates softly and returns values of an image, 0 to 255.


MATERIALS: Mapping[Surface, Callable[[Spots], Floats]] = {
    Surface.ROCK: materials.rock,
    Surface.BUSH: materials.bush,
    Surface.TRUNK: materials.bark,
    Surface.CROWN: materials.crown,
    Surface.WALL: materials.masonry,
    Surface.GRASS: materials.blade,
    Surface.WALKER: materials.clothes,
    Surface.VEHICLE: materials.paint,
}
LEAVES = (Surface.BUSH, Surface.CROWN, Surface.GRASS)  # light passes through them
THROUGH, UPON = np.float32(0.25), np.float32(0.55)
BOUNCE_RATIO = 0.15  # share of the beam that the ground reflects upwards
LEAST_COSINE = 0.25  # a higher limit would be exact along the ray, but blur across it
LAMP_NEAR_M2 = 1.0  # a lamp has an extent
LAMP_TINT = single((1.0, 0.97, 0.9))
CLOUD_HEIGHT = 1.6  # in units in which their largest wavelength is 2.2
GAMMA = 1.95
_TO_8BIT = (255 * (1 - np.exp(-np.linspace(0, 6, 4096))) ** (1 / GAMMA)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Seen:
    """The hits of rays, which of them (N,) the beam does not reach, and the ground height below a hit mover (N,), NaN
    elsewhere.
    """

    origins: Rays
    directions: Rays
    hits: Hits
    is_shaded: NDArray[np.bool_]
    foot_m: Floats
    pixel_rad: float


def pixels_of(seen: Seen, cover: GroundCover, light: Light, lamps: Array) -> NDArray[np.uint8]:
    """Return the camera's colours (N, 3); `lamps` (L, 7) are position, axis and strength."""
    is_met = np.isfinite(seen.hits.range_m)
    met, unmet = np.flatnonzero(is_met), np.flatnonzero(~is_met)
    seen_light = np.empty((len(is_met), 3), np.float32)
    seen_light[unmet] = sky(seen.directions[unmet], light)
    surface, reach = seen.hits.surface[met], seen.hits.range_m[met]
    spots, facing, ground = _spots(seen, met, cover)
    upon = _received(facing, np.isin(surface, LEAVES), seen.is_shaded[met], light)
    upon += _lamplight(spots.points, facing, lamps)
    kept = np.exp(-reach / np.float32(light.haze_m))[:, None]
    haze = single(light.horizon) * (1 - kept)
    seen_light[met] = haze + kept * colours(surface, spots, ground) * upon
    return shown(seen_light, light.exposure)


def shown(light: Floats, exposure: float) -> NDArray[np.uint8]:
    """Return image values (N, 3) for linear light: 1 − e^−x, then a gamma."""
    steps = np.float32(exposure * (len(_TO_8BIT) - 1) / 6) * light
    return np.asarray(_TO_8BIT[np.minimum(steps, len(_TO_8BIT) - 1).astype(np.int32)])


def sky(directions: Rays, light: Light) -> Floats:
    """Return the sky's colour (N, 3): horizon to zenith, clouds, and the glow around the sun or moon; haze below the
    horizon.
    """
    up = np.maximum(directions[:, 2], np.float32(0))
    high = np.sqrt(up)[:, None]
    clear = single(light.horizon) * (1 - high) + single(light.zenith) * high
    beam = single(light.beam)
    plan = directions[:, :2] * (CLOUD_HEIGHT / (up + np.float32(0.12)))[:, None]
    cover = plane_fractal(plan, 2.2, 5, np.full(len(up), 0.02, np.float32), 151) + 0.5 * light.clouds - 0.18
    cloud = (np.clip(2.2 * cover, 0, 0.9) * np.minimum(8 * up, 1)).astype(np.float32)[:, None]
    along = np.maximum(directions @ light.towards.astype(np.float32), 0)[:, None]
    glow = (0.06 * along**8 + 0.5 * along**150 + 8 * (along > 0.9999)) * (1 - 0.7 * cloud)
    lit = 0.22 * beam + 0.6 * single(light.horizon)
    return np.asarray(clear * (1 - cloud) + lit * cloud + glow * beam, np.float32)


def colours(surface: NDArray[np.uint8], spots: Spots, ground: Floats) -> Floats:
    """Return the share of light that each spot reflects (N, 3); `ground` contains the cover's layers there."""
    result = np.zeros((len(surface), 3), np.float32)
    where = np.flatnonzero(surface == Surface.GROUND)
    result[where] = _ground_colours(spots.of(where), ground[where])
    for kind, colour in MATERIALS.items():
        where = np.flatnonzero(surface == kind)
        if len(where):
            result[where] = colour(spots.of(where))
    return result


def _spots(seen: Seen, met: NDArray[np.int64], cover: GroundCover) -> tuple[Spots, Floats, Floats]:
    """Return the hits as spots, their normals turned to the viewer (N, 3), and the cover's layers there."""
    reach, directions = seen.hits.range_m[met], seen.directions[met]
    points = seen.origins[met] + directions * reach[:, None]
    ground = cover.at(points[:, :2])
    normals = seen.hits.normal[met]
    cosine = np.einsum("ni,ni->n", normals, directions)
    facing = np.where(cosine[:, None] > 0, -normals, normals)
    is_ground = seen.hits.surface[met] == Surface.GROUND
    facing[is_ground] = smooth_normals(ground[is_ground])  # the triangles are flat
    footprint = reach * np.float32(seen.pixel_rad) / np.sqrt(np.maximum(np.abs(cosine), np.float32(LEAST_COSINE)))
    foot = np.where(np.isnan(seen.foot_m[met]), ground[:, HEIGHT], seen.foot_m[met])
    return Spots(points, normals, points[:, 2] - foot, np.maximum(footprint, 1e-4)), facing, ground


def _ground_colours(spots: Spots, ground: Floats) -> Floats:
    """Return the mixture of the materials that cover these spots; noise makes their borders ragged."""
    edge = 0.7 * spots.plane_noise(0.6, 5, 139)
    shares = np.clip(0.5 + 2.5 * (ground[:, [SOIL, GRAVEL, ROCK]] + edge[:, None] * single((1, -1, 1)) - 0.5), 0, 1)
    rest = np.maximum(1 - shares.sum(axis=1), 0)
    result = np.zeros((len(rest), 3), np.float32)
    where = np.flatnonzero(rest > 0)
    result[where] = rest[where, None] * materials.grass(spots.of(where), ground[where, TALL])
    for index, colour in enumerate((materials.soil, materials.gravel, materials.rock)):
        where = np.flatnonzero(shares[:, index] > 0)
        result[where] += shares[where, index, None] * colour(spots.of(where))
    return np.asarray(result / (shares.sum(axis=1) + rest)[:, None])


def _received(facing: Floats, is_leaf: NDArray[np.bool_], is_shaded: NDArray[np.bool_], light: Light) -> Floats:
    """Return the light on surfaces (N, 3): the beam unless shaded, half of the sky's light and half of the ground's."""
    slant = facing @ light.towards.astype(np.float32)
    slant = np.where(is_leaf, THROUGH + UPON * np.abs(slant), np.maximum(slant, 0))
    above = np.where(is_leaf, np.float32(0.6), 0.5 + 0.5 * facing[:, 2])
    beam = np.where(is_shaded, 0, slant) + BOUNCE_RATIO * light.towards[2] * (1 - above)
    sky_light = (single(light.zenith) + single(light.horizon)) / 2
    return np.asarray(beam[:, None] * single(light.beam) + (above[:, None] + 0.1) * sky_light, np.float32)


def _lamplight(points: Floats, facing: Floats, lamps: Array) -> Floats:
    """Return the lamps' light on surfaces (N, 3): inverse square, falling off from the axis as cos⁴."""
    total = np.zeros(len(points), np.float32)
    for lamp in lamps.astype(np.float32):
        away = points - lamp[:3]
        square = np.einsum("ni,ni->n", away, away)
        distance = np.sqrt(square)
        axial = np.maximum(away @ lamp[3:6], 0) / distance
        slant = np.maximum(-np.einsum("ni,ni->n", away, facing), 0) / distance
        total += lamp[6] * axial**4 * slant / (square + np.float32(LAMP_NEAR_M2))
    return np.asarray(total[:, None] * LAMP_TINT)
