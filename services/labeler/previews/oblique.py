"""The label grid of one frame from behind and above, in perspective."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.labeler.previews.render import Boxes, Camera, Canvas, Colour, beads, solid_boxes, voxel_boxes
from services.labeler.previews.surroundings import ALONE, Surroundings, runs_inside
from stone.labels.class_colours import INK, TRACK
from stone.labels.grid import GRID_MIN_M
from stone.sensors.calibration import Box, Footprint

WIDTH_PX, HEIGHT_PX = 800, 480
CAMERA = Camera(np.array([-38.0, 12.0, 25.0]), np.array([-2.0, -0.6, -3.0]), np.deg2rad(60.0))
ROBOT: Colour = (52, 58, 68)
BEAD_M, BEADS_APART_M, BEAD_FOOT_M, BEAD_TOP_M = 0.14, 0.1, -0.1, 0.32


def oblique(
    grids: Mapping[str, NDArray[np.uint8]],
    around: Surroundings = ALONE,
    size_px: tuple[int, int] = (WIDTH_PX, HEIGHT_PX),
) -> Image.Image:
    """The picture of `grids["semantics"]` with the robot and its track; what is not labelled is not drawn."""
    canvas = Canvas(CAMERA, *size_px)
    canvas.add(voxel_boxes(np.ascontiguousarray(grids["semantics"]), np.array(GRID_MIN_M)))
    for run in runs_inside(around.track_ego):
        canvas.add(track_boxes(run))
    for boxes in robot_boxes(around.footprint):
        canvas.add(boxes)
    return canvas.image()


def track_boxes(track: NDArray[np.float64]) -> Boxes:
    """Beads along the track (P, 3), close enough to be a line, standing out of the voxels they lie in."""
    steps_m = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    at_m = np.arange(0.0, along_m[-1] + BEADS_APART_M, BEADS_APART_M)
    centre = np.stack([np.interp(at_m, along_m, track[:, axis]) for axis in range(3)], axis=1)
    half = np.array([BEAD_M / 2, BEAD_M / 2, 0.0])
    low, high = centre - half + (0, 0, BEAD_FOOT_M), centre + half + (0, 0, BEAD_TOP_M)
    return beads(np.concatenate([low, high], axis=1).astype(np.float32), TRACK)


def robot_boxes(footprint: Footprint) -> list[Boxes]:
    """A body on the footprint, a mast, and a head at its front, so that one sees which way it looks."""
    x, y = footprint.length_m / 2, footprint.width_m / 2
    body = solid_boxes([Box((-x, -y, 0.15), (x, y, 0.6)), Box((-0.08, -0.08, 0.6), (0.08, 0.08, 1.1))], ROBOT)
    nose = solid_boxes([Box((x - 0.25, -y, 0.6), (x, y, 0.75))], (245, 245, 245))
    return [body, nose, solid_boxes([Box((-0.16, -0.16, 1.1), (0.16, 0.16, 1.35))], INK)]
