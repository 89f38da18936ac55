"""What the stages leave for each other, and which of it a tile looks at."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from services.labeler.map.fuse import fuse
from services.labeler.parameters import LabelParameters, TilingParameters
from services.labeler.run import LabelRun
from services.labeler.scratch import images_near, images_path
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD = World(frames=14, step_m=6.0)
PARAMETERS = LabelParameters(tiling=TilingParameters(frames_per_part=4))


def run_in(folder, every_frame=3):
    dynamic = replace(PARAMETERS.dynamic, every_frame=every_frame, max_range_m=20.0)
    return LabelRun(sequence_of(WORLD), RayCast(WORLD), replace(PARAMETERS, dynamic=dynamic), folder)


def gap_m(place, low, high):
    """From the place to the box, axis by axis."""
    return sum(max(a - p, p - b, 0.0) ** 2 for p, a, b in zip(place, low, high, strict=True)) ** 0.5


@pytest.mark.parametrize("every_frame", [1, 3, 5])
def test_a_tile_looks_at_every_image_taken_within_reach_of_it(tmp_path, every_frame):
    run = run_in(tmp_path, every_frame)
    for begin in range(0, 14, 4):
        fuse(run, (begin, min(begin + 4, 14)))
    low, high = np.array([10.0, 20.0, -1.0]), np.array([14.0, 30.0, 2.0])
    places = [run.sequence.frames.map_from_ego[index] @ run.sensor_ego for index in range(0, 14, every_frame)]
    near = [place for place in places if gap_m(place, low, high) < 20.0]
    assert 0 < len(near) < len(places)
    images = list(chain.from_iterable(images_near(run, 0, low, high)))
    np.testing.assert_array_equal([image.map_from_view.translation_m for image in images], near)
    assert all((image.ranges_m > 0).any() for image in images)


def test_a_tile_looks_at_no_part_that_is_out_of_its_reach(tmp_path):
    """Which parts happen to be fused already, or not yet, changes nothing."""
    run = run_in(tmp_path)
    low, high = np.array([58.0, 20.0, -1.0]), np.array([68.0, 30.0, 2.0])
    for begin in (8, 12):
        fuse(run, (begin, min(begin + 4, 14)))
    early = [image.ranges_m for images in images_near(run, 0, low, high) for image in images]
    for begin in (0, 4):
        fuse(run, (begin, begin + 4))
    late = [image.ranges_m for images in images_near(run, 0, low, high) for image in images]
    assert len(early) == len(late) == 2
    assert all((a == b).all() for a, b in zip(early, late, strict=True))


def test_an_image_that_is_not_there_yet_is_not_passed_over(tmp_path):
    run = run_in(tmp_path)
    with pytest.raises(FileNotFoundError, match=images_path(run, (0, 4)).name):
        list(images_near(run, 0, np.array([-20.0, 20.0, -1.0]), np.array([-10.0, 30.0, 2.0])))
