"""Small faults of a calibration are mended and said, large ones refused; differences are as large as what was moved."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stone.errors import ShapeError
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount
from stone.sensors.calibration_checks import (
    check_calibration,
    check_image_size,
    check_intrinsics,
    check_translation,
    checked_norm,
    checked_rotation,
    checked_transform,
    quaternion_and_translation,
    require_mounts,
)
from stone.sensors.calibration_diff import ValueChange, difference, transform_change
from stone.sensors.calibration_errors import ImageSizeError, MissingSensorError
from testing.refusals import refused_as

seeds = st.integers(0, 2**32)
CAMERA = CameraIntrinsics("plumb_bob", 1920, 1200, 1000.0, 1000.0, 960.0, 600.0, (0.0,) * 5)
OPTICAL_WXYZ = np.array([0.5, -0.5, 0.5, -0.5])


def a_rotation(seed):
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def changed(**facts):
    return CameraIntrinsics(**{**CAMERA.__dict__, **facts})


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_a_rotation_with_five_decimals_passes_as_it_is(seed):
    rounded = np.round(a_rotation(seed), 5)
    kept, findings = checked_rotation("CAM", rounded)
    np.testing.assert_array_equal(kept, rounded)
    assert findings == ()


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_a_rotation_slightly_off_is_projected_to_the_nearest_and_said(seed):
    random = np.random.default_rng(seed)
    stretch = random.normal(size=(3, 3))
    stretch += stretch.T
    stretch *= random.uniform(2e-4, 2e-3) / np.linalg.norm(stretch)  # so ‖RᵀR−I‖ is 4e-4 to 4e-3, within the warning
    exact = a_rotation(seed)
    mended, findings = checked_rotation("CAM", exact @ (np.eye(3) + stretch))
    np.testing.assert_allclose(mended.T @ mended, np.eye(3), atol=1e-12)
    assert np.linalg.det(mended) == pytest.approx(1)
    np.testing.assert_allclose(mended, exact, atol=1e-12)  # the rotation of a polar decomposition is the nearest
    assert [(f.code, f.severity, f.topic) for f in findings] == [("CAL-401", "warning", "CAM")]


@settings(max_examples=30, deadline=None)
@given(seeds, st.sampled_from([0.0, 0.9687, 0.9990, 1.1, 1e200]))
def test_scaled_and_collapsed_rotations_are_refused(seed, factor):
    with refused_as("CAL-401"):
        checked_rotation("CAM", a_rotation(seed) * [1, 1, factor if factor != 0.999 else 0.99])


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(0, 2))
def test_a_mirror_is_refused_whatever_the_axis(seed, axis):
    mirrored = a_rotation(seed)
    mirrored[:, axis] *= -1
    with refused_as("CAL-408"):
        checked_rotation("LIDAR", mirrored)


def test_a_transposed_matrix_is_refused_by_its_last_row():
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    with refused_as("CAL-407"):
        checked_transform("CAM", matrix.T)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_a_good_matrix_is_read_exactly(seed):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = a_rotation(seed), (0.1, -0.2, 1.5)
    transform, findings = checked_transform("CAM", matrix)
    np.testing.assert_allclose(transform.as_matrix(), matrix, atol=1e-12)
    assert findings == ()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_everywhere(bad):
    for check, given_values in (
        (checked_transform, np.full((4, 4), bad)),
        (checked_rotation, np.full((3, 3), bad)),
        (checked_norm, np.full(4, bad)),
        (check_translation, np.full(3, bad)),
        (check_intrinsics, changed(fx_px=bad)),
    ):
        with refused_as("CAL-416"):
            check("CAM", given_values)


def test_other_shapes_are_refused():
    checks = ((checked_transform, (3, 4)), (checked_rotation, (2, 2)), (checked_norm, (3,)), (check_translation, (2,)))
    for check, shape in checks:
        with pytest.raises(ShapeError):
            check("CAM", np.zeros(shape))


@pytest.mark.parametrize(("norm", "count"), [(1.0, 0), (1.0009, 0), (0.9985, 1), (1.0095, 1)])
def test_the_norm_of_a_quaternion_is_graded(norm, count):
    transform, findings = quaternion_and_translation("INS", "ins", np.array([norm, 0, 0, 0]), np.zeros(3))
    assert [f.code for f in findings] == ["CAL-402"] * count
    np.testing.assert_allclose(transform.wxyz, [1, 0, 0, 0])


@pytest.mark.parametrize("norm", [0.0, 0.98, 1.02, 1e300])
def test_a_quaternion_far_from_unit_is_refused(norm):
    with refused_as("CAL-402"):
        checked_norm("INS", np.array([norm, 0, 0, 0]))


@pytest.mark.parametrize("kind", ["lidar", "radar", "ins", "imu"])
def test_a_sensor_that_looks_backwards_is_not_doubted(kind):
    assert quaternion_and_translation("REAR", kind, np.array([0.0, 0, 0, 1]), np.zeros(3))[1] == ()


@pytest.mark.parametrize("yaw_deg", [75, 90, 150, 180])
def test_a_level_sensor_turned_sideways_and_written_as_xyzw_is_doubted(yaw_deg):
    """At small angles the mistake reads as another level mount; nothing in the numbers tells."""
    half_rad = np.deg2rad(yaw_deg) / 2
    _, findings = quaternion_and_translation(
        "INS", "ins", np.array([0, 0, np.sin(half_rad), np.cos(half_rad)]), np.zeros(3)
    )
    assert [finding.code for finding in findings] == ["CAL-402"]


@pytest.mark.parametrize("yaw_deg", [-150, -60, 0, 45, 120])
def test_an_upright_camera_is_not_doubted_and_its_xyzw_is_when_it_tips(yaw_deg):
    turned = Rotation.from_euler("z", yaw_deg, degrees=True) * Rotation.from_quat(np.roll(OPTICAL_WXYZ, -1))
    wxyz = np.roll(turned.as_quat(), 1)
    assert quaternion_and_translation("CAM", "camera", wxyz, np.zeros(3))[1] == ()
    swapped = SE3.from_parts(np.roll(wxyz, -1), np.zeros(3))
    is_tipped = (swapped @ np.array([0.0, -1.0, 0.0]))[2] < 0.5
    findings = quaternion_and_translation("CAM", "camera", swapped.wxyz, np.zeros(3))[1]
    assert [f.code for f in findings] == ["CAL-402"] * bool(is_tipped)


def test_a_long_lever_is_graded():
    assert check_translation("GNSS", np.array([9.9, 0, 0])) == ()
    assert check_translation("GNSS", np.array([0, 11.0, 0]))[0].code == "CAL-409"
    with refused_as("CAL-409"):
        check_translation("GNSS", np.array([0, 0, 1200.0]))


def test_intrinsics_are_checked_against_model_and_image():
    assert check_intrinsics("CAM", CAMERA) == ()
    with refused_as("CAL-410"):
        check_intrinsics("CAM", changed(distortion=(0.0,) * 4))
    for wrong in ({"fy_px": -5.0}, {"cy_px": 1200.0}):
        with refused_as("CAL-411"):
            check_intrinsics("CAM", changed(**wrong))


@pytest.mark.parametrize(
    ("facts", "count"), [({"fx_px": 100.0, "fy_px": 100.0}, 3), ({"cx_px": 100.0}, 1), ({"fx_px": 1100.0}, 1)]
)
def test_unusual_intrinsics_are_said(facts, count):
    assert [(f.code, f.severity) for f in check_intrinsics("CAM", changed(**facts))] == [("CAL-411", "warning")] * count


def test_a_camera_calibrated_for_another_image_size_is_refused():
    mount = Mount("CAM_FRONT", "camera", SE3.identity(), intrinsics=CAMERA)
    check_image_size(mount, 1920, 1200)
    check_image_size(Mount("INS", "ins", SE3.identity()), 1, 1)
    with pytest.raises(ImageSizeError):
        check_image_size(mount, 960, 600)


def moved(name, x_m=1.0):
    return Mount(name, "radar", SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([x_m, 0, 0])))


def test_a_whole_calibration_is_checked():
    assert check_calibration(Calibration("a", SE3.identity(), (moved("A"), moved("B", 0.0)))) == ()
    with refused_as("CAL-413"):
        check_calibration(Calibration("a", SE3.identity(), (moved("A"), moved("A", 2.0))))
    for wrong in ({"footprint": Footprint(1.0, 0.0)}, {"self_boxes_ego": (Box((0, 0, 0), (1, 1, 0)),)}):
        with refused_as("CAL-415"):
            check_calibration(Calibration("a", SE3.identity(), **wrong))
    copies = check_calibration(Calibration("a", SE3.identity(), (moved("A", 0.0), moved("B", 0.0))))
    assert [finding.code for finding in copies] == ["CAL-417"]


def test_a_missing_sensor_is_named_with_those_there_are():
    calibration = Calibration("a", SE3.identity(), (moved("RADAR_LEFT"),))
    require_mounts(calibration, ("RADAR_LEFT",), "the test")
    with pytest.raises(MissingSensorError):
        require_mounts(calibration, ("INS",), "the INS pose")


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
