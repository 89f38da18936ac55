"""The ray-casting scene: the ground and the objects in embree, movers added in closed form.

**Conventions.** Rays are (N, 3) float32 origins and unit directions in the world; a miss has range inf. The scene uses
all cores; its results do not depend on their number.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from simulator.scenery.movers import Mover
from simulator.scenery.objects import Surface
from simulator.scenery.terrain import Terrain
from simulator.scenery.world import SimulatedWorld
from stone.geometry.se3 import Array

Rays = NDArray[np.float32]
MOVER_MARGIN_RAD = 0.03


@dataclass(frozen=True, eq=False)
class Hits:
    """The hits of rays: range (N,) metres, `Surface` (N,), and the world normal (N, 3) of the hit surface."""

    range_m: NDArray[np.float32]
    surface: NDArray[np.uint8]
    normal: NDArray[np.float32]


class RayScene:
    """A scene, built once per world; `cast` as often as needed."""

    def __init__(self, world: SimulatedWorld) -> None:
        self.world = world
        objects = world.objects
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(*(_tensor(part) for part in ground_mesh(world.terrain)))
        corners = np.ascontiguousarray(objects.triangles.reshape(-1, 3))
        faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        self._scene.add_triangles(_tensor(corners), _tensor(faces))
        self._object_surface = objects.surface

    def cast(self, origins: Rays, directions: Rays) -> Hits:
        """Return the nearest hit of each ray with static surfaces."""
        rays = np.concatenate([origins, directions], axis=1, dtype=np.float32)
        answer = self._scene.cast_rays(_tensor(rays))
        range_m = answer["t_hit"].numpy()
        is_object = answer["geometry_ids"].numpy() == 1
        surface = np.where(np.isfinite(range_m), np.uint8(Surface.GROUND), np.uint8(Surface.SKY))
        surface[is_object] = self._object_surface[answer["primitive_ids"].numpy()[is_object]]
        return Hits(range_m, surface, answer["primitive_normals"].numpy())

    def is_hidden(self, points: Rays, towards: Rays) -> NDArray[np.bool_]:
        """Return whether a static surface lies between each point (N, 3) and infinity in the direction `towards`."""
        rays = np.concatenate([points, np.broadcast_to(towards, points.shape)], axis=1, dtype=np.float32)
        hidden: NDArray[np.bool_] = self._scene.test_occlusions(_tensor(rays)).numpy()
        return hidden


def _tensor(array: NDArray[Any]) -> Any:
    """Return an Open3D tensor of the array's own type; Open3D's stubs lack this form."""
    return o3d.core.Tensor.from_numpy(array)


def put_mover(
    hits: Hits, mover: Mover, stamp_ns: int, rays: tuple[Rays, Rays], where: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Let a mover occlude what is behind it at this time, for the rays `where`; changes `hits` in place.

    Return the rays that hit it.
    """
    origins, directions = rays[0][where], rays[1][where]
    reach = mover.ranges_m(stamp_ns, origins, directions)
    is_nearer = reach < hits.range_m[where]
    index = where[is_nearer]
    hits.range_m[index] = reach[is_nearer]
    hits.surface[index] = mover.surface
    hits.normal[index] = -directions[is_nearer]
    return index


def rays_towards(place_m: Array, reach_m: float, origins: Rays, directions: Rays) -> NDArray[np.int64]:
    """Return the rays whose bearing and length come near a mover's position, as candidates for the closed form."""
    offset = place_m[:2].astype(np.float32) - origins[0, :2]
    distance = max(float(np.hypot(*offset)), 0.3)
    along = directions[:, 0] * (offset[0] / distance) + directions[:, 1] * (offset[1] / distance)
    flat = float(np.cos(min(np.arctan2(reach_m, distance) + MOVER_MARGIN_RAD, np.pi / 2)))
    return np.flatnonzero(along > 0.8 * flat)


def ground_mesh(terrain: Terrain) -> tuple[Rays, NDArray[np.uint32]]:
    """Return vertices (V, 3) and triangles (F, 3) of the lattice, two per cell."""
    rows, columns = terrain.height_m.shape
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    plan = np.stack([x, y], axis=-1) * terrain.resolution_m + np.asarray(terrain.origin_m)
    vertices = np.concatenate([plan, terrain.height_m[..., None]], axis=-1).reshape(-1, 3).astype(np.float32)
    cell = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None]).ravel()
    lower = np.stack([cell, cell + 1, cell + columns], axis=1)
    upper = np.stack([cell + 1, cell + columns + 1, cell + columns], axis=1)
    return vertices, np.concatenate([lower, upper]).astype(np.uint32)
