"""Stage 1, per part: read its sweeps once and write the point map and the observed voxels of each tile.

Every n-th sweep also gives a range image, with which the surface stage votes on moving objects.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.far_points import FarPoints, far_points_of, save_far_points
from services.labeler.map.fused_files import fused_columns
from services.labeler.run import LabelRun, Part, Step, Tile, core_cells, silent, tiles_of
from services.labeler.scratch import fused_path, save, save_images
from stone.labels.observed_voxels import BRICK, Carver, Observed
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Box
from stone.sensors.selection import selected
from stone.surface.pointmap import PointMap, PointMapBuilder
from stone.surface.range_image import range_image
from stone_base.label_grid import LabelGrid


def fuse(run: LabelRun, part: Part, step: Step = silent) -> int:
    """Fuse the frames of `part`, one step each; return the number of points added to the map."""
    parameters, frames = run.parameters, run.sequence.frames
    calibration = run.sequence.calibration
    builder = PointMapBuilder(parameters.surface.point_voxel_m)
    carver = Carver(parameters.carve)
    images, far = dict[int, NDArray[np.float32]](), FarPoints()
    imaged = run.every(parameters.dynamic.every_frame)
    reach = labelled_box(parameters.selection.margin_m, parameters.grids)
    for index in range(*part):
        sweep = run.sweeps.sweep(index)
        pose, far = frames.map_from_ego[index], far + far_points_of(sweep)
        points = selected(
            sweep.points_lidar, calibration.ego_from_lidar, calibration.self_boxes_ego, parameters.selection.min_range_m
        )
        builder.insert(points.world_ego, pose, run.sensor_ego, reach)
        if index % run.every(parameters.carve.every(len(points.world_ego))) == 0:
            carver.carve(points.world_ego, pose, run.sensor_ego, index)
        if index % imaged == 0:
            image = range_image(points.points_ego, pose, run.sensor_ego, parameters.dynamic)
            images[index] = image.ranges_m
        step(index + 1 - part[0], part[1] - part[0])
    _leave(run, part, builder.finish(), carver.finish())
    save_far_points(run, part, far)
    if images:
        save_images(run, part, images)
    return int(builder.points)


def labelled_box(margin_m: float, grids: Iterable[LabelGrid]) -> Box:
    """Return the union of the label grids, `margin_m` wider on every side, in the ego frame."""
    x, y, z = (min(lows) for lows in zip(*(grid.min_m for grid in grids), strict=True))
    u, v, w = (max(highs) for highs in zip(*(grid.max_m for grid in grids), strict=True))
    return Box((x - margin_m, y - margin_m, z - margin_m), (u + margin_m, v + margin_m, w + margin_m))


def _leave(run: LabelRun, part: Part, points: PointMap, observed: Observed) -> None:
    """Write one file per tile that this part touched."""
    point_tiles = tiles_of(points.keys, core_cells(run.parameters, points.voxel_m))
    brick_tiles = tiles_of(observed.keys, core_cells(run.parameters, VOXEL_M * BRICK))
    for i, j in sorted(_distinct(point_tiles) | _distinct(brick_tiles)):
        mine = (point_tiles[:, 0] == i) & (point_tiles[:, 1] == j)
        bricks = (brick_tiles[:, 0] == i) & (brick_tiles[:, 1] == j)
        mapped = points.where(mine), observed.where(bricks)
        save(fused_path(run, Tile(i, j, run.map_of(part)), part), fused_columns(*mapped))


def _distinct(tiles: NDArray[np.int64]) -> set[tuple[int, int]]:
    """Return the distinct tiles of (N, 2); keys are sorted, so equal tiles are adjacent."""
    starts = np.append(True, (np.diff(tiles, axis=0) != 0).any(axis=1))[: len(tiles)]
    return {(int(i), int(j)) for i, j in tiles[starts]}
