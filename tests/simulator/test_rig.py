"""The rig's geometry and clockwork, without a world."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.bag_writer import BagWriter
from simulator.calibration_yaml import write_calibration
from simulator.options import SimulateOptions, SimulationOptionError
from simulator.sensors import rig
from simulator.sensors.lidar import robot_range
from stone_recordings.calibrations.file import read_calibration


def test_every_camera_fires_inside_the_sweep_when_the_lidar_looks_its_way() -> None:
    for camera in rig.cameras():
        assert 0 < camera.phase_ns < rig.SWEEP_NS
        column = round(camera.phase_ns / rig.SWEEP_NS * 3600)
        looks = rig.EGO_FROM_LIDAR.rotation() @ rig.lidar_directions(2, 3600)[column, 0]
        off_rad = np.arctan2(looks[1], looks[0]) - camera.yaw_rad
        assert np.cos(off_rad) == pytest.approx(1.0, abs=1e-5)


def test_cameras_look_along_their_yaw_with_the_horizon_level() -> None:
    for camera in rig.cameras():
        rotation = rig.ego_from_camera(camera).rotation()
        np.testing.assert_allclose(rotation[:, 2], [np.cos(camera.yaw_rad), np.sin(camera.yaw_rad), 0], atol=1e-12)
        np.testing.assert_allclose(rotation[:, 1], [0, 0, -1], atol=1e-12)


def test_the_lidar_turns_clockwise_from_plus_y_in_its_own_frame() -> None:
    fan = rig.lidar_directions(3, 360)
    azimuth = np.unwrap(np.arctan2(fan[:, 1, 0], fan[:, 1, 1]))
    assert np.all(np.diff(azimuth) > 0)
    np.testing.assert_allclose(np.linalg.norm(fan, axis=-1), 1.0)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(fan[0, :, 2])), [15, -5, -25], atol=1e-9)


@given(st.integers(12, 7200))
def test_packets_divide_the_columns(columns: int) -> None:
    steps = rig.sweep_steps(columns)
    assert 1 <= steps <= 100
    assert columns % steps == 0


@pytest.mark.parametrize(("columns", "steps"), [(900, 100), (1800, 100)])
def test_usual_sweeps_have_a_pose_every_millisecond(columns: int, steps: int) -> None:
    assert rig.sweep_steps(columns) == steps


def test_the_lidar_sees_the_pole_at_its_distance() -> None:
    offset = np.array([*rig.POLE_EGO_XY_M, 0.0])
    distance = np.linalg.norm(offset)
    towards = rig.EGO_FROM_LIDAR.rotation().T @ (offset / distance)
    seen = robot_range(np.stack([towards, -towards]))
    assert seen[0] == pytest.approx(distance - rig.POLE_RADIUS_M, abs=1e-6)
    assert np.isinf(seen[1])


def test_all_that_the_lidar_sees_of_the_robot_lies_in_its_self_boxes() -> None:
    directions = rig.lidar_directions(128, 1800).reshape(-1, 3)
    reach = robot_range(directions)
    hit = np.isfinite(reach)
    points = rig.EGO_FROM_LIDAR @ (directions[hit] * reach[hit, None].astype(np.float64))
    inside = np.zeros(len(points), bool)
    for box in rig.SELF_BOXES_EGO:
        inside |= np.all((points >= np.array(box.min_m) + 0.06) & (points < np.array(box.max_m) - 0.06), axis=1)
    assert hit.sum() > 100
    assert inside.all()


def test_the_calibration_file_reads_back_as_the_rig(tmp_path: Path) -> None:
    rigged = rig.calibration(480)
    write_calibration(rigged, tmp_path / "rig.yaml")
    read, findings = read_calibration(tmp_path / "rig.yaml")
    assert not [finding for finding in findings if finding.severity == "error"]
    assert [mount.name for mount in read.mounts] == [mount.name for mount in rigged.mounts]
    np.testing.assert_allclose(read.ego_from_lidar.wxyz_xyz, rigged.ego_from_lidar.wxyz_xyz, atol=1e-12)
    for ours, theirs in zip(rigged.mounts, read.mounts, strict=True):
        np.testing.assert_allclose(theirs.lidar_from_sensor.as_matrix(), ours.lidar_from_sensor.as_matrix(), atol=1e-12)
        assert (theirs.kind, theirs.frame_id, theirs.intrinsics) == (ours.kind, ours.frame_id, ours.intrinsics)
    assert read.self_boxes_ego == rigged.self_boxes_ego


@pytest.mark.parametrize(
    ("name", "value"),
    [("seconds", 0.0), ("seconds", float("nan")), ("channels", 1), ("columns", 8000), ("compression", "rar")],
)
def test_options_beyond_the_rig_are_refused(name: str, value: object) -> None:
    with pytest.raises(SimulationOptionError, match=f"{name} is "):
        SimulateOptions(**{name: value})


def test_the_writer_sorts_by_log_time_and_holds_back_what_may_be_preceded() -> None:
    class Sink:
        def __init__(self) -> None:
            self.times: list[int] = []

        def register_schema(self, *_: object) -> int:
            return 1

        register_channel = register_schema

        def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int) -> None:
            self.times.append(log_time)

    sink = Sink()
    bag = BagWriter(sink)  # type: ignore[arg-type]
    bag.declare("/imu", "sensor_msgs/msg/Imu")
    for time_ns in (30, 10, 20):
        bag.add("/imu", time_ns, b"")
    bag.flush_before(25)
    assert sink.times == [10, 20]
    bag.flush_before(31)
    assert sink.times == [10, 20, 30]
