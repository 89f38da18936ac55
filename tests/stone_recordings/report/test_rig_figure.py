"""The drawing of a rig as a file: whole, the same each time, of hostile names and places too; names apart."""

from io import BytesIO
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from simulator.sensors.rig import calibration
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount
from stone_recordings.report.rig.figure import LETTER_RATIO, LINE_RATIO, Label, rig_figure, spread
from stone_recordings.report.rig.record import LIDAR, PlacedSensor, fields_of_view_deg, placed_sensors

SVG = "{http://www.w3.org/2000/svg}"
UP = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, 1.0]))


def words(drawn: bytes) -> list[str]:
    return ["".join(text.itertext()) for text in ElementTree.fromstring(drawn).iter(f"{SVG}text")]


@pytest.mark.whole
def test_every_sensor_is_named_in_both_views_but_one_too_far_away() -> None:
    rig = calibration(640)
    said = words(rig_figure(rig, True))
    for mount in rig.mounts:
        assert said.count(mount.name) == 2
    assert {"from above", "from the right", "footprint 1.06 x 0.85 m"} <= set(said)
    bare = words(rig_figure(Calibration("bare", UP), False))
    assert "footprint 1.06 x 0.85 m (the default: none is given), no self boxes" in bare
    far = Mount("ON_THE_MOON", "radar", SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([90.0, 0.0, 0.0])))
    said = words(rig_figure(Calibration("a", UP, (far,)), True))
    assert "ON_THE_MOON" not in said
    assert any(text.endswith("too far away to draw: ON_THE_MOON") for text in said)


@pytest.mark.whole
@pytest.mark.parametrize("picture", ["svg", "png"])
def test_equal_rigs_give_equal_bytes(picture: str) -> None:
    first, second = (rig_figure(calibration(640), True, picture) for _ in range(2))  # type: ignore[arg-type]
    assert first == second
    if picture == "png":
        assert Image.open(BytesIO(first)).size == (1792, 1008)


@pytest.mark.whole
def test_names_are_text_whatever_they_are() -> None:
    names = ("$x^2$", "a\x1b[2Jb", "車", "<script>", "\u202eevil", "n" * 100, "%s{}")
    mounts = tuple(Mount(name, "camera", SE3.identity()) for name in names)
    rig = Calibration("<script>$_$", UP, mounts, Footprint(3.0, 1.6), (Box((0, 0, 0), (1e9, 1, 1)),))
    drawn = rig_figure(rig, True)
    assert b"<script" not in drawn
    assert b"\x1b" not in drawn
    words(drawn)
    rig_figure(rig, True, "png")


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=14))
def test_no_two_names_stand_on_each_other(places: list[tuple[float, float]]) -> None:
    side = 4.0
    placed = spread([Label(f"CAM_{number:02}", at) for number, at in enumerate(places)], side)
    assert [label.at for label, _ in placed] == places
    for number, (label, (x, y)) in enumerate(placed):
        for other, (other_x, other_y) in placed[:number]:
            wide = LETTER_RATIO * side * (len(label.text) + len(other.text)) / 2
            assert abs(x - other_x) >= wide - 1e-9 or abs(y - other_y) >= LINE_RATIO * side - 1e-9


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
