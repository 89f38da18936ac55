"""Places and directions of sensors: by scipy's angles, for every mount; fields of view of a lens by its corners."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone_recordings.report.rig.places import LIDAR, PlacedSensor, fields_of_view_deg, placed_sensors

ANGLES = st.tuples(st.floats(-179, 179), st.floats(-85, 85), st.floats(-179, 179))
FORWARD = SE3.from_parts(np.array([0.5, -0.5, 0.5, -0.5]), np.zeros(3))  # an optical frame that looks along x
WIDE = CameraIntrinsics("pinhole", 800, 600, 400.0, 300.0, 400.0, 300.0)


def turned(rpy_deg: tuple[float, float, float]) -> SE3:
    x, y, z, w = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_quat()
    return SE3.from_parts(np.array([w, x, y, z]), np.zeros(3))


@given(ANGLES)
def test_angles_are_those_about_fixed_axes_and_a_cameras_are_its_links(rpy_deg: tuple[float, float, float]) -> None:
    pose = turned(rpy_deg)
    radar = PlacedSensor(Mount("R", "radar", pose), pose)
    assert radar.rpy_deg == pytest.approx(rpy_deg, abs=1e-5)
    camera = PlacedSensor(Mount("C", "camera", pose @ FORWARD), pose @ FORWARD)
    assert camera.rpy_deg == pytest.approx(rpy_deg, abs=1e-5)
    np.testing.assert_allclose(camera.looks, radar.looks, atol=1e-12)


def test_a_lidar_that_is_listed_for_its_clock_is_the_lidar_itself_and_another_is_not() -> None:
    up = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, 1.5]))
    rear = Mount("REAR", "lidar", SE3.from_parts(np.array([0.0, 0, 0, 1]), np.array([-1.0, 0, 0])))
    alone = placed_sensors(Calibration("a", up, (rear,)))
    assert [sensor.mount.name for sensor in alone] == [LIDAR, "REAR"]
    assert alone[1].at_m.tolist() == [-1.0, 0.0, 1.5]
    listed = placed_sensors(Calibration("a", up, (rear, Mount("TOP", "lidar", SE3.identity(), time_offset_ns=5))))
    assert [sensor.mount.name for sensor in listed] == ["TOP", "REAR"]


def test_fields_of_view_are_those_of_the_lens() -> None:
    assert fields_of_view_deg(WIDE) == pytest.approx((90.0, 90.0))
    fisheye = CameraIntrinsics("equidistant", 800, 400, 200.0, 200.0, 400.0, 200.0, (0.0, 0.0, 0.0, 0.0))
    assert fields_of_view_deg(fisheye) == pytest.approx((np.rad2deg(4.0), np.rad2deg(2.0)))
    assert fields_of_view_deg(CameraIntrinsics("equidistant", 9000, 10, 1.0, 10.0, 1.0, 1.0))[0] == 360.0
