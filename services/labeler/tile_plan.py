"""The parts of a run that can reach each tile: computed from the poses, before any sweep is read.

A tile is therefore reconstructed as soon as the last part that can reach it is fused, while the rest of the run is
still being read. The same plan gives the tasks of one machine and the jobs of the queue.

**Conventions.** Reach is in plan. A frame contributes points within the labelled box and voxels along traced rays, and
votes on moving objects: all within `reach_m` of the ego's origin.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.fuse import labelled_box
from services.labeler.parameters import LabelParameters
from services.labeler.run import LabelRun, Part, Tile, parts_of, tiles_across
from stone.labels.grid import frame_bounds
from stone.labels.observed_voxels import BRICK
from stone.labels.voxels import VOXEL_M


@dataclass(frozen=True)
class TilePlan:
    """`needs`: for every tile within reach, the parts that can reach its cube, in order.

    Tiles are in the order of their earliest start: by the last of their parts, then by position.
    """

    parts: tuple[Part, ...]
    needs: Mapping[Tile, tuple[Part, ...]]


def plan_of(run: LabelRun) -> TilePlan:
    """Return the plan of a run; every tile has a frame."""
    parts = tuple(parts_of(run))
    places = run.sequence.frames.map_from_ego.translation_m[:, :2]
    reach = reach_m(run.parameters, run.sensor_ego)
    needs: dict[Tile, tuple[Part, ...]] = {}
    for tile in (tile for number in np.unique(run.maps).tolist() for tile in _tiles_around(run, number, reach)):
        is_near = (run.maps == tile.map) & (_gaps_m(places, tile, run.parameters) <= reach)
        needs[tile] = tuple(part for part in parts if is_near[slice(*part)].any())
    reached = [tile for tile in needs if needs[tile]]
    return TilePlan(parts, {tile: needs[tile] for tile in sorted(reached, key=lambda tile: (needs[tile][-1], tile))})


def tiles_around(run: LabelRun, part: Part) -> list[Tile]:
    """Return the tiles that the label grids of a part can overlap."""
    bounds = frame_bounds(run.sequence.frames.map_from_ego[slice(*part)], run.parameters.grid)
    return tiles_across(run.parameters, bounds, run.map_of(part))


def reach_m(parameters: LabelParameters, sensor_ego: NDArray[np.float64]) -> float:
    """Return the distance in metres from the ego's origin within which a frame contributes."""
    box = labelled_box(parameters.selection.margin_m, parameters.grids)
    corner = np.maximum(np.abs(box.min_m), np.abs(box.max_m))
    sensor_m = float(np.linalg.norm(sensor_ego))
    brick_m = BRICK * VOXEL_M
    rays_m = max(parameters.carve.max_range_m, parameters.dynamic.max_range_m) + sensor_m
    return max(float(np.linalg.norm(corner)), rays_m) + brick_m


def _tiles_around(run: LabelRun, number: int, reach: float) -> list[Tile]:
    """Return every tile of a map whose core is within reach of a frame, frame by frame, since runs can be very long."""
    core_m = run.parameters.core_m
    places = run.sequence.frames.map_from_ego.translation_m[run.maps == number, :2]
    cells = np.unique(np.floor(places / core_m).astype(np.int64), axis=0)
    ring = int(np.ceil(reach / core_m))
    shifts = np.stack(np.meshgrid(*[np.arange(-ring, ring + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    around = np.unique((cells[:, None] + shifts).reshape(-1, 2), axis=0)
    return [Tile(int(i), int(j), number) for i, j in around]


def _gaps_m(places: NDArray[np.float64], tile: Tile, parameters: LabelParameters) -> NDArray[np.float64]:
    """Return the distance of each position (N, 2) from the tile's cube in plan; 0 inside."""
    low = tile.place * parameters.core_m - parameters.tiling.halo_m
    high = low + parameters.core_m + 2 * parameters.tiling.halo_m
    gaps = np.maximum(0.0, np.maximum(low - places, places - high))
    return np.asarray(np.hypot(gaps[:, 0], gaps[:, 1]))
