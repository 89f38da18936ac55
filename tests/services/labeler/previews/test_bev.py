"""The plan of a frame with what is drawn on it: where things are."""

import numpy as np

from services.labeler.previews.sheet import Surroundings, bev, runs_inside
from stone.labels.class_colours import INK, TRACK
from stone.sensors.calibration import Footprint
from stone_base.label_grid import PAPER


def test_the_robot_is_in_the_middle_and_its_track_where_it_drove():
    grids = {"semantics": np.zeros(PAPER.shape, np.uint8)}
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
