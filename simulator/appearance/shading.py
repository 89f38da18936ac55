"""Pixels of what rays met: the surface's colour, in beam, sky light and lamps, through haze, as a camera shows it.

**Conventions.** Arrays are of rays: directions and normals (N, 3) float32 in the map frame, ranges (N,) in metres, inf
for the sky. Light is linear until `shown`, which saturates softly and gives values of a picture, 0 to 255.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.appearance import materials
from simulator.appearance.ground_cover import GRAVEL, HEIGHT, ROCK, SOIL, TALL, GroundCover, smooth_normals
from simulator.appearance.lights import Light
from simulator.appearance.materials import Spots
from simulator.appearance.noise import Floats, plane_fractal, single
from simulator.scenery.objects import Surface
from simulator.scenery.scene import Hits, Rays
from stone.geometry.se3 import Array

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
LEAVES = (Surface.BUSH, Surface.CROWN, Surface.GRASS)  # light goes through them
THROUGH, UPON = np.float32(0.25), np.float32(0.55)
BOUNCE_RATIO = 0.15  # of the beam upon the ground that it sends back up
LEAST_COSINE = 0.25  # more would be right along the ray, and blur across it
LAMP_NEAR_M2 = 1.0  # a lamp is no point
LAMP_TINT = single((1.0, 0.97, 0.9))
CLOUD_HEIGHT = 1.6  # in units in which their largest wavelength is 2.2
GAMMA = 1.95
_TO_8BIT = (255 * (1 - np.exp(-np.linspace(0, 6, 4096))) ** (1 / GAMMA)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Seen:
    """What rays met: hits, which of them (N,) the beam does not reach, and the height on which a mover
    stands that was met (N,), NaN of others, which stand on the ground."""

    origins: Rays
    directions: Rays
    hits: Hits
    is_shaded: NDArray[np.bool_]
    foot_m: Floats
    pixel_rad: float


def pixels_of(seen: Seen, cover: GroundCover, light: Light, lamps: Array) -> NDArray[np.uint8]:
    """Colours (N, 3) as the camera shows them; `lamps` (L, 7) are place, axis and strength."""
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
    """Values of a picture (N, 3) for linear light: 1 − e^−x, then a gamma."""
    steps = np.float32(exposure * (len(_TO_8BIT) - 1) / 6) * light
    return np.asarray(_TO_8BIT[np.minimum(steps, len(_TO_8BIT) - 1).astype(np.int32)])


def sky(directions: Rays, light: Light) -> Floats:
    """Horizon to zenith, clouds, and the glow round the sun or moon (N, 3); below the horizon, haze."""
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
    """What each spot reflects (N, 3); `ground` holds the cover's layers there."""
    result = np.zeros((len(surface), 3), np.float32)
    where = np.flatnonzero(surface == Surface.GROUND)
    result[where] = _ground_colours(spots.of(where), ground[where])
    for kind, colour in MATERIALS.items():
        where = np.flatnonzero(surface == kind)
        if len(where):
            result[where] = colour(spots.of(where))
    return result


def _spots(seen: Seen, met: NDArray[np.int64], cover: GroundCover) -> tuple[Spots, Floats, Floats]:
    """The hits as spots, their normals turned to the viewer (N, 3), and the cover's layers there."""
    reach, directions = seen.hits.range_m[met], seen.directions[met]
    points = seen.origins[met] + directions * reach[:, None]
    ground = cover.at(points[:, :2])
    normals = seen.hits.normal[met]
    cosine = np.einsum("ni,ni->n", normals, directions)
    facing = np.where(cosine[:, None] > 0, -normals, normals)
    is_ground = seen.hits.surface[met] == Surface.GROUND
    facing[is_ground] = smooth_normals(ground[is_ground])  # its triangles are flat
    footprint = reach * np.float32(seen.pixel_rad) / np.sqrt(np.maximum(np.abs(cosine), np.float32(LEAST_COSINE)))
    foot = np.where(np.isnan(seen.foot_m[met]), ground[:, HEIGHT], seen.foot_m[met])
    return Spots(points, normals, points[:, 2] - foot, np.maximum(footprint, 1e-4)), facing, ground


def _ground_colours(spots: Spots, ground: Floats) -> Floats:
    """The materials that cover these spots, by their shares; noise makes their borders ragged."""
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
    """Light upon surfaces (N, 3): the beam unless shaded, the sky's half above and the ground's below."""
    slant = facing @ light.towards.astype(np.float32)
    slant = np.where(is_leaf, THROUGH + UPON * np.abs(slant), np.maximum(slant, 0))
    above = np.where(is_leaf, np.float32(0.6), 0.5 + 0.5 * facing[:, 2])
    beam = np.where(is_shaded, 0, slant) + BOUNCE_RATIO * light.towards[2] * (1 - above)
    sky_light = (single(light.zenith) + single(light.horizon)) / 2
    return np.asarray(beam[:, None] * single(light.beam) + (above[:, None] + 0.1) * sky_light, np.float32)


def _lamplight(points: Floats, facing: Floats, lamps: Array) -> Floats:
    """Light of the lamps upon surfaces (N, 3): inverse square, narrowing from the axis as cos⁴."""
    total = np.zeros(len(points), np.float32)
    for lamp in lamps.astype(np.float32):
        away = points - lamp[:3]
        square = np.einsum("ni,ni->n", away, away)
        distance = np.sqrt(square)
        axial = np.maximum(away @ lamp[3:6], 0) / distance
        slant = np.maximum(-np.einsum("ni,ni->n", away, facing), 0) / distance
        total += lamp[6] * axial**4 * slant / (square + np.float32(LAMP_NEAR_M2))
    return np.asarray(total[:, None] * LAMP_TINT)
