"""Casts the cameras' rays and paints what they meet, in the chosen light.

**Conventions.** Rays are taken in pieces of `PIECE_RAYS`, of one camera or of several, so that memory does not grow
with the pictures. A shade ray goes from each hit towards the beam; movers cast shade as they hide: in closed form.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.appearance.ground_cover import build_ground_cover
from simulator.appearance.lights import LIGHTS, Light
from simulator.appearance.shading import LEAVES, Seen, pixels_of
from simulator.options import SimulateOptions
from simulator.scenery.movers import Mover
from simulator.scenery.scene import Hits, Rays, RayScene, put_mover, rays_towards
from simulator.scenery.world import generator
from stone.geometry.se3 import Array

PIECE_RAYS = 1 << 17
CLEARANCE_M = 0.02


@dataclass(frozen=True, eq=False)
class View:
    """Rays of one or more cameras (N, 3), the angle between neighbours, when movers are seen, and the robot's lamps
    (L, 7): place, axis, strength."""

    origins: Rays
    directions: Rays
    pixel_rad: float
    stamp_ns: int
    lamps: Array

    def of(self, piece: slice) -> "View":
        """Some of its rays."""
        return replace(self, origins=self.origins[piece], directions=self.directions[piece])


class Renderer:
    """Built once per recording."""

    def __init__(self, scene: RayScene, options: SimulateOptions) -> None:
        self.world = scene.world
        self._scene = scene
        self._light = LIGHTS[options.illumination]
        self._cover = build_ground_cover(scene.world.terrain, generator(options.seed, "cover"))

    def pixels(self, view: View) -> NDArray[np.uint8]:
        """Colours (N, 3) of a view."""
        begins = range(0, len(view.directions), PIECE_RAYS)
        return np.concatenate([self._pixels(view.of(slice(begin, begin + PIECE_RAYS))) for begin in begins])

    def _pixels(self, view: View) -> NDArray[np.uint8]:
        hits, foot_m = self._hits(view)
        seen = Seen(view.origins, view.directions, hits, self._shaded(view, hits), foot_m, view.pixel_rad)
        return pixels_of(seen, self._cover, self._light, view.lamps)

    def _hits(self, view: View) -> tuple[Hits, NDArray[np.float32]]:
        """Nearest hits, of movers with their own normals, and the height on which these stand (N,), NaN of others."""
        origins, directions = view.origins, view.directions
        hits = self._scene.cast(origins, directions)
        foot_m = np.full(len(directions), np.nan, np.float32)
        for mover in self.world.movers:
            place = mover.route.at(view.stamp_ns)[0]
            towards = rays_towards(place, mover.reach_m, origins, directions)
            met = put_mover(hits, mover, view.stamp_ns, (origins, directions), towards)
            points = origins[met] + directions[met] * hits.range_m[met, None]
            hits.normal[met] = mover.normals(points.astype(np.float64), view.stamp_ns)
            foot_m[met] = place[2]
        return hits, foot_m

    def _shaded(self, view: View, hits: Hits) -> NDArray[np.bool_]:
        """Which rays (N,) met what the beam does not reach."""
        is_shaded = np.zeros(len(hits.range_m), np.bool_)
        if not self._light.casts_shade:
            return is_shaded
        met = np.flatnonzero(np.isfinite(hits.range_m))
        towards = self._light.towards.astype(np.float32)
        directions = view.directions[met]
        side = np.where(np.isin(hits.surface[met], LEAVES)[:, None], -towards, directions)  # no leaf shades itself
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
    """Indices of the points from which the way to the light passes near a mover, in plan."""
    ahead = light.towards[:2] / np.linalg.norm(light.towards[:2])
    offset = mover.route.at(stamp_ns)[0][:2].astype(np.float32) - points[:, :2]
    along, across = (offset @ way.astype(np.float32) for way in (ahead, np.array([-ahead[1], ahead[0]])))
    return np.flatnonzero((along > -mover.reach_m) & (np.abs(across) < mover.reach_m))
