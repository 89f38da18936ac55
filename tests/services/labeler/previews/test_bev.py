"""The plan of a frame against a loop over its columns, and where things are in it."""

import numpy as np

from services.labeler.picture import CLASS_RGB, INK, PAPER, TRACK
from services.labeler.previews.bev import bev, plan
from services.labeler.previews.lettering import UNSEEN
from services.labeler.previews.surroundings import Surroundings, runs_inside
from stone.calibration import Footprint
from stone.grid import GRID_SHAPE


def test_every_column_shows_its_highest_label_and_forward_is_up():
    rng = np.random.default_rng(0)
    semantics = np.zeros(GRID_SHAPE, np.uint8)
    semantics[40:90, 60:140] = (rng.integers(1, 4, (50, 80, 32)) * (rng.random((50, 80, 32)) < 0.05)).astype(np.uint8)
    mask = np.zeros(GRID_SHAPE, np.uint8)
    mask[:128, :, 3] = 1
    shown = plan({"semantics": semantics, "mask_lidar": mask})
    hues = np.array([CLASS_RGB[kind] for kind in (1, 2, 3)], float)
    for i, j in [*rng.integers(0, 256, (300, 2)).tolist(), *rng.integers((40, 60), (90, 140), (300, 2)).tolist()]:
        kinds = [int(kind) for kind in semantics[i, j] if kind]
        colour = shown[255 - i, 255 - j]
        if not kinds:
            assert tuple(colour) == (PAPER if mask[i, j].any() else UNSEEN)
        else:  # the class's colour in more or less light
            ratio = np.median(colour / hues[kinds[-1] - 1])
            np.testing.assert_allclose(colour, np.minimum(hues[kinds[-1] - 1] * ratio, 255), atol=2.5)


def test_relief_that_rises_is_lit_otherwise_than_relief_that_falls():
    semantics = np.zeros(GRID_SHAPE, np.uint8)
    for i in range(100, 110):
        semantics[i, :, i - 95] = 2
        semantics[i + 20, :, 20 - (i - 95)] = 2
    shown = plan({"semantics": semantics})
    assert shown[255 - 104, 100, 0] != shown[255 - 124, 100, 0]


def test_the_robot_is_in_the_middle_and_its_track_where_it_drove():
    grids = {"semantics": np.zeros(GRID_SHAPE, np.uint8)}
    track = np.array([[-30.0, 0, 0], [-10.0, 5.0, 0], [0.0, 5.0, 0], [10.0, 5.0, 0], [40.0, 5.0, 0]])
    picture = np.asarray(bev(grids, Surroundings(track, Footprint(2.0, 1.0)), 512))
    assert picture.shape == (512, 512, 3)
    across = 256 - 50
    assert tuple(picture[200, across]) == TRACK  # 5 m to the left, on the way from 0 to 10 m ahead
    assert tuple(picture[56, across]) != TRACK  # 20 m ahead: it left the grid between the poses
    assert tuple(picture[256 + 8, 256]) == INK  # 0.8 m behind the origin, within 2 m × 1 m
    assert tuple(picture[256, 256 + 8]) != INK


def test_a_track_is_cut_where_it_leaves_the_grid():
    x = np.concatenate([np.linspace(-30, 30, 61), np.linspace(30, -10, 41)])
    runs = runs_inside(np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1))
    assert [(run[0, 0], run[-1, 0]) for run in runs] == [(-25, 25), (25, -10)]
    assert runs_inside(np.zeros((0, 3))) == []
