"""A rig is drawn where its calibration says: places, fields of view, names that do not stand upon each other."""

import math

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from web.rig import FARTHEST_M, rig_of

LENS = CameraIntrinsics("pinhole", 800, 600, 400.0, 400.0, 400.0, 300.0)  # 90° wide
FORWARD = np.array([0.5, -0.5, 0.5, -0.5])  # an optical frame that looks along x


def rig(*mounts: Mount, height_m: float = 1.0) -> Calibration:
    return Calibration("rig", SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0, 0, height_m])), mounts)


def camera(at_m: tuple[float, float, float], name: str = "CAM_FRONT") -> Mount:
    return Mount(name, "camera", SE3.from_parts(FORWARD, np.array(at_m)), intrinsics=LENS)


def test_forward_is_up_from_above_and_right_from_the_side() -> None:
    top, side = rig_of(rig(camera((0.4, 0.1, -0.2)))).views
    assert [(round(mark.x), round(mark.y)) for mark in top.marks] == [(0, 0), (-10, -40)]
    assert [(round(mark.x), round(mark.y)) for mark in side.marks] == [(0, -100), (40, -80)]


def test_a_camera_is_drawn_with_the_field_of_view_of_its_lens() -> None:
    front = rig_of(rig(camera((0.0, 0.0, 0.0)))).views[0].marks[1]
    numbers = front.wedge.replace("M", " ").replace("L", " ").replace("A", " ").replace("Z", "").split()
    (x0, y0), (x1, y1) = [(float(numbers[at]), float(numbers[at + 1])) for at in (2, 9)]
    assert x0 == pytest.approx(-x1)
    assert y0 == pytest.approx(y1)
    assert math.degrees(math.atan2(x1, -y1)) == pytest.approx(45.0, abs=0.2)


def test_a_sensor_that_is_said_to_be_far_away_is_named_and_not_drawn() -> None:
    drawn = rig_of(rig(camera((FARTHEST_M + 1, 0.0, 0.0)), camera((0.1, 0.0, 0.0), "CAM_BACK")))
    assert drawn.left_out == ("CAM_FRONT",)
    assert [mark.name for mark in drawn.views[0].marks] == ["LIDAR", "CAM_BACK"]
    assert len(drawn.places) == 3


def test_of_names_in_one_place_one_is_written() -> None:
    at = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.zeros(3))
    top = rig_of(rig(Mount("INS", "ins", at), Mount("IMU", "imu", at))).views[0]
    assert [mark.label for mark in top.marks] == ["lidar", "", ""]
