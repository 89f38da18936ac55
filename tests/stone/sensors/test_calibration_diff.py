"""Nothing differs from itself, what differs is measured as it was moved, and the way back is as long."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone.sensors.calibration_diff import ValueChange, difference, transform_change

angles = st.tuples(*[st.floats(-3.1, 3.1)] * 3)
places = st.tuples(*[st.floats(-5, 5)] * 3)


def placed(rotvec, xyz) -> SE3:
    return SE3.from_parts(np.roll(Rotation.from_rotvec(rotvec).as_quat(), 1), np.array(xyz, float))


LENS = CameraIntrinsics("plumb_bob", 640, 480, 500, 500, 320, 240, (0.1, 0, 0, 0, 0))
MOUNTS = (
    Mount("CAM_FRONT", "camera", placed((0.1, 0.2, 0.3), (1, 2, 3)), "cam", 0, LENS),
    Mount("INS", "ins", placed((0, 0, 0), (0, 0, -0.5)), "gps"),
)
BEFORE = Calibration("mule", placed((0, 0, 0.1), (0, 0, 0.9)), MOUNTS)


@given(angles, places)
def test_nothing_differs_from_itself(rotvec, xyz) -> None:
    mount = replace(MOUNTS[0], lidar_from_sensor=placed(rotvec, xyz))
    found = difference(replace(BEFORE, mounts=(mount,)), replace(BEFORE, mounts=(mount,)))
    assert found.is_same
    assert [sensor.status for sensor in found.sensors] == ["same"]


@given(angles, places, angles, places)
def test_a_change_is_as_large_as_scipy_says_and_as_large_the_other_way(r1, t1, r2, t2) -> None:
    before, after = placed(r1, t1), placed(r2, t2)
    there, back = transform_change(before, after), transform_change(after, before)
    expected = np.rad2deg((Rotation.from_rotvec(r1).inv() * Rotation.from_rotvec(r2)).magnitude())
    assert there.rotation_deg == pytest.approx(expected, abs=1e-6)
    assert there.distance_m == pytest.approx(float(np.linalg.norm(np.subtract(t2, t1))))
    np.testing.assert_allclose(there.translation_m, np.subtract(t2, t1), atol=1e-12)
    assert (back.rotation_deg, back.distance_m) == pytest.approx((there.rotation_deg, there.distance_m), abs=1e-9)


def test_sensors_that_come_and_go_are_named() -> None:
    radar = Mount("RADAR_LEFT", "radar", SE3.identity())
    found = difference(BEFORE, replace(BEFORE, mounts=(MOUNTS[0], radar)))
    assert [(sensor.name, sensor.status) for sensor in found.sensors] == [
        ("CAM_FRONT", "same"),
        ("RADAR_LEFT", "added"),
        ("INS", "removed"),
    ]
    assert not found.is_same


def test_every_value_of_a_lens_that_changed_is_named() -> None:
    lens = replace(LENS, fx_px=503.5, model="equidistant", distortion=(0.1, 0, 0, 0.02))
    after = replace(MOUNTS[0], intrinsics=lens, time_offset_ns=-1500, frame_id="other")
    sensor = difference(BEFORE, replace(BEFORE, mounts=(after, MOUNTS[1]))).sensors[0]
    assert (sensor.status, sensor.time_offset_ns) == ("changed", -1500)
    assert sensor.values == (
        ValueChange("frame_id", "cam", "other"),
        ValueChange("model", "plumb_bob", "equidistant"),
        ValueChange("fx_px", 500, 503.5),
        ValueChange("distortion_3", 0, 0.02),
        ValueChange("distortion_4", 0, None),
    )


def test_a_moved_lidar_changes_the_whole() -> None:
    found = difference(BEFORE, replace(BEFORE, ego_from_lidar=placed((0, 0, 0.1), (0, 0, 0.95))))
    assert found.ego_from_lidar.distance_m == pytest.approx(0.05)
    assert not found.is_same
