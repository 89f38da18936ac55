"""`map.png`: the whole labelled map in perspective, with the robot's track."""

from pathlib import Path

import numpy as np
from PIL import Image

from services.labeler.previews.lettering import legend
from services.labeler.previews.map_pieces import Extent, MapPiece, Pieces, extent_of
from services.labeler.previews.render import Boxes, Camera, Canvas, voxel_boxes
from services.labeler.previews.sheet import track_boxes
from services.labeler.scratch import whole
from stone.geometry.corners import corners_of
from stone.geometry.lattice import centres_of, indices_of
from stone.geometry.se3 import SE3
from stone.labels.class_colours import PAPER
from stone.labels.voxels import VOXEL_M

WIDTH_PX, HEIGHT_PX, BAR_PX, TEXT_PX = 1280, 720, 48, 24
VIEW_RAD = np.deg2rad(40.0)
EVERY, MARGIN_RATIO, NEAREST_M = 8, 0.03, 8.0
# From the south-west and above: unit steps from the middle of the map to the eye.
TOWARDS_EYE = np.array([-0.62, -0.46, 0.63])


def write_map_oblique(pieces: Pieces, map_from_ego: SE3, path: Path) -> None:
    """Draw `map_oblique` and save it as a PNG."""
    picture = map_oblique(pieces, map_from_ego)
    with whole(path) as staging:
        picture.save(staging, "png", optimize=True)


def map_oblique(pieces: Pieces, map_from_ego: SE3) -> Image.Image:
    """Return all tiles in one picture, one in memory at a time; an empty map gives background and legend."""
    sheet = Image.new("RGB", (WIDTH_PX, HEIGHT_PX + BAR_PX), PAPER)
    extent = extent_of(pieces)
    if extent is not None:
        canvas = Canvas(_camera(pieces, extent), WIDTH_PX, HEIGHT_PX)
        for load in pieces:
            if len((piece := load()).keys):
                canvas.add(_boxes(piece))
        canvas.add(track_boxes(map_from_ego.translation_m))
        sheet.paste(canvas.image(), (0, 0))
    legend(sheet, (16, HEIGHT_PX + BAR_PX / 2), TEXT_PX, with_unseen=False)
    return sheet


def _camera(pieces: Pieces, extent: Extent) -> Camera:
    """Return the nearest camera that shows all voxels, judged by every `EVERY`-th voxel."""
    target = extent.low_m() + extent.size_m() / 2
    towards = TOWARDS_EYE / np.linalg.norm(TOWARDS_EYE)
    turn = Camera(target + towards, target, VIEW_RAD).matrix()[:, :3]
    half = np.tan(VIEW_RAD / 2) * (1.0 - MARGIN_RATIO)
    distance_m = NEAREST_M
    for load in pieces:
        across, down, away = turn @ (centres_of(load().keys[::EVERY], VOXEL_M) - target).T
        needed_m = np.maximum(np.abs(across) / half, np.abs(down) / (half * HEIGHT_PX / WIDTH_PX)) - away
        distance_m = max(distance_m, float(needed_m.max(initial=0.0)))
    return Camera(target + towards * distance_m, target, VIEW_RAD)


def _boxes(piece: MapPiece) -> Boxes:
    indices = indices_of(piece.keys)
    low, high = corners_of(indices)
    block = np.zeros(tuple(high - low + 1), np.uint8)
    block[tuple((indices - low).T)] = piece.classes
    return voxel_boxes(block, low * VOXEL_M)
