"""Orientations that are not the robot's are refused, whatever tells them; right ones are believed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.ingest.sandboxed_inspection import inspected_in
from stone.errors import Refused
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.poses.file_poses import PoseFile
from testing.worlds.field.drive import BEGIN_S, FieldDrive, FieldTopic
from testing.worlds.field.outcome import FieldOutcome, labelled, occupied_iou, outcome_of
from testing.worlds.field.paths import PathDrive, crabbing, level, reversing, standing, straight

Yaw = Callable[[float, float], float]
LIKE_THE_SOUND_DRIVE, BY_COURSE = 0.97, 0.9
NOISE = np.random.default_rng(5)


def turned(message: Any, yaw: float, tilt: float = 0.0) -> Any:
    """Return an orientation message of a yaw after a roll."""
    half, side = yaw / 2, tilt / 2
    message.x, message.y = float(np.cos(half) * np.sin(side)), float(np.sin(half) * np.sin(side))
    message.z, message.w = float(np.sin(half) * np.cos(side)), float(np.cos(half) * np.cos(side))
    return message


def yaw_of(quaternion: Any) -> float:
    return 2 * float(np.arctan2(quaternion.z, quaternion.w))


def frozen(t: float, yaw: float) -> float:
    """The right yaw until the filter stops."""
    return yaw if t < 1.2 else float(np.arctan(0.625 * np.cos(0.6)))


ODOMETRY: dict[str, Yaw] = {
    "never set": lambda _t, _yaw: 0.0,
    "some constant": lambda _t, _yaw: 0.4,
    "a constant with noise": lambda _t, _yaw: 0.4 + float(NOISE.normal(0, 0.004)),
    "turned the other way": lambda _t, yaw: -yaw,
    "clockwise from north": lambda _t, yaw: np.pi / 2 - yaw,
    "stopped midway": frozen,
}


def odometry_of(drive: FieldDrive, yaw: Yaw, child: str = "base_link") -> FieldTopic:
    def message(t: float) -> Any:
        made = drive.odometry(t, "map", child)
        turned(made.pose.pose.orientation, yaw(t, yaw_of(made.pose.pose.orientation)))
        return made

    return FieldTopic("/odometry/gps", 0.1, 0.2, message)


def imu_of(
    drive: FieldDrive, yaw: Yaw, tilt: Callable[[float], float] = lambda _t: 0.0, name: str = "/imu/data"
) -> FieldTopic:
    def message(t: float) -> Any:
        made = drive.imu(t)
        turned(made.orientation, yaw(t, yaw_of(made.orientation)), tilt(t))
        return made

    return FieldTopic(name, 0.01, 0.2, message)


def assert_refused(found: FieldOutcome, *words: str) -> None:
    assert found.refusal == "SYN-530"
    assert [finding.code for finding in found.errors] == ["SYN-530"]
    for word in words:
        assert word in found.messages("SYN-530")


@pytest.mark.parametrize("case", ODOMETRY)
@pytest.mark.parametrize("drive", [FieldDrive(), PathDrive()], ids=["bare ground", "pillars"])
def test_an_odometry_that_does_not_turn_as_the_robot_is_refused(tmp_path: Path, drive: FieldDrive, case: str) -> None:
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), odometry_of(drive, ODOMETRY[case]))
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert_refused(found, "/odometry/gps", "--odometry course:/odometry/gps")
    assert ("--odometry kiss-icp" in found.messages("SYN-530")) == isinstance(drive, PathDrive)
    with open_bag(run) as bag:  # without a calibration as well
        errors = [finding for finding in inspected_in(bag).findings if finding.severity == "error"]
    assert [finding.code for finding in errors] == ["SYN-530"]


def test_the_sweeps_are_a_way_out_where_they_show_the_way(tmp_path: Path) -> None:
    drive, asked = PathDrive(), SynchroniseOptions(odometry_topic="kiss-icp")
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), odometry_of(drive, ODOMETRY["never set"], ""))
    found = outcome_of(run, calibration, tmp_path / "labels", asked)
    assert found.refusal == ""
    assert not found.errors


def test_the_course_is_a_way_out_where_the_robot_drives_forward(tmp_path: Path) -> None:
    drive, asked = FieldDrive(), SynchroniseOptions(odometry_topic="course:/odometry/gps")
    sound = drive.write(tmp_path / "sound", drive.lidar_topic(), drive.odometry_topic())
    assert labelled(*sound, tmp_path / "right", SynchroniseOptions()).refusal == ""
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), odometry_of(drive, ODOMETRY["never set"], ""))
    found = outcome_of(run, calibration, tmp_path / "labels", asked)
    assert found.refusal == ""
    assert "SYN-531" in found.codes
    assert occupied_iou(tmp_path / "labels", tmp_path / "right") >= LIKE_THE_SOUND_DRIVE


@pytest.mark.parametrize("kind", ["PoseStamped", "tf", "file"])
def test_no_kind_of_source_is_believed_without_an_attitude(tmp_path: Path, kind: str) -> None:
    drive, options = FieldDrive(), SynchroniseOptions()

    def stamped(t: float) -> Any:
        made = drive.odometry(t, "map")
        turned(made.pose.pose.orientation, 0.0)
        return drive.of("geometry_msgs/msg/PoseStamped", made.header, made.pose.pose)

    def transforms(t: float) -> Any:
        made = stamped(t)
        place = made.pose.position
        moved = drive.of("geometry_msgs/msg/Transform", drive.vector(place.x, place.y, place.z), made.pose.orientation)
        link = drive.of("geometry_msgs/msg/TransformStamped", drive.header(t, "odom"), "base_link", moved)
        return drive.of("tf2_msgs/msg/TFMessage", [link])

    topics = {"PoseStamped": FieldTopic("/pose", 0.1, 0.2, stamped), "tf": FieldTopic("/tf", 0.1, 0.2, transforms)}
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), *[topics[kind]] if kind in topics else ())
    if kind == "file":
        file = tmp_path / "poses.txt"
        places = [(t, stamped(float(t)).pose.position) for t in np.arange(-0.2, 4.2, 0.1)]
        file.write_text("".join(f"{BEGIN_S + t:.3f} {p.x:.6f} {p.y:.6f} {p.z:.6f} 0 0 0 1\n" for t, p in places))
        options = SynchroniseOptions(poses=PoseFile(file))
    assert_refused(outcome_of(run, calibration, tmp_path / "labels", options))


@pytest.mark.parametrize("case", [*ODOMETRY, "yaw never filled"])
def test_an_imu_that_does_not_turn_as_the_robot_is_refused_and_another_is_named(tmp_path: Path, case: str) -> None:
    drive = PathDrive()
    fixes = FieldTopic("/gps/fix", 0.1, 0.2, drive.fix)
    wrong = imu_of(drive, ODOMETRY.get(case, ODOMETRY["never set"]), lambda t: 0.02 * np.sin(5 * t))
    right = imu_of(drive, lambda _t, yaw: yaw, name="/imu/filtered")
    run, calibration = drive.write(tmp_path / "both", drive.lidar_topic(), fixes, wrong, right)
    asked = SynchroniseOptions(topics={"imu": "/imu/data"}, is_hashed=False)
    with open_bag(run) as bag:
        rig, _ = read_calibration(calibration, bag)
    with pytest.raises(Refused, match="--topic imu=/imu/filtered; or") as refused:
        synchronise(run, rig, asked, "run")
    assert refused.value.code == "SYN-530"
    advised = SynchroniseOptions(topics={"imu": "/imu/filtered"}, is_hashed=False, is_checked=False)
    assert len(synchronise(run, rig, advised, "run")[0].frames) == 40
    run, calibration = drive.write(tmp_path / "one", drive.lidar_topic(), fixes, wrong)
    assert_refused(outcome_of(run, calibration, tmp_path / "labels"), "--odometry course:/gps/fix")


def test_positions_without_any_imu_are_labelled_by_their_course(tmp_path: Path) -> None:
    drive = FieldDrive()
    fixes = FieldTopic("/gps/fix", 0.1, 0.2, drive.fix)
    sound = drive.write(tmp_path / "sound", drive.lidar_topic(), fixes, imu_of(drive, lambda _t, yaw: yaw))
    assert labelled(*sound, tmp_path / "right", SynchroniseOptions()).refusal == ""
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), fixes)
    found = outcome_of(run, calibration, tmp_path / "labels", SynchroniseOptions(odometry_topic="course:/gps/fix"))
    assert found.refusal == ""
    assert "SYN-531" in found.codes
    assert occupied_iou(tmp_path / "labels", tmp_path / "right") >= BY_COURSE


@pytest.mark.parametrize("path", [straight, reversing, crabbing, standing])
def test_a_right_attitude_is_believed_however_the_robot_drives(tmp_path: Path, path: Any) -> None:
    drive = PathDrive(path=path)
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), drive.odometry_topic())
    with open_bag(run) as bag:
        findings = inspected_in(bag, calibration=calibration).findings
    errors = {finding.code for finding in findings if finding.severity == "error"}
    assert errors == ({"no_reference"} if path is standing else set())  # a robot that stands covers no ground


def test_a_robot_that_drives_aside_is_not_labelled_by_its_course(tmp_path: Path) -> None:
    drive = PathDrive(path=crabbing)
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), drive.odometry_topic("/odom"))
    found = outcome_of(run, calibration, tmp_path / "labels", SynchroniseOptions(odometry_topic="course:/odom"))
    assert_refused(found, "take the poses of /odom")


def aslant(t: Any) -> tuple[Any, Any, Any, Any]:
    """A straight way to the north-east."""
    x, _y, _z, yaw = straight(t)
    return level(0.7 * x, 0.7 * x, yaw + np.pi / 4)


@pytest.mark.parametrize("yaw", ["never set", "turned the other way"])
def test_a_straight_track_does_not_hide_an_orientation_that_points_elsewhere(tmp_path: Path, yaw: str) -> None:
    drive = PathDrive(path=aslant)
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), odometry_of(drive, ODOMETRY[yaw]))
    assert_refused(outcome_of(run, calibration, tmp_path / "labels"), "off the heading")


def test_a_robot_that_turns_on_the_spot_has_no_constant_orientation(tmp_path: Path) -> None:
    drive = PathDrive(path=lambda t: level(0 * np.asarray(t), 0 * np.asarray(t), 0.4 * np.asarray(t, np.float64)))
    sources = [odometry_of(drive, ODOMETRY["never set"]), odometry_of(drive, lambda _t, yaw: yaw)]
    codes = []
    for number, source in enumerate(sources):
        run, calibration = drive.write(tmp_path / str(number), drive.lidar_topic(), source)
        with open_bag(run) as bag:
            codes.append({one.code for one in inspected_in(bag, calibration=calibration).findings})
    assert "SYN-530" in codes[0]
    assert "SYN-530" not in codes[1]


def test_one_wrong_stretch_is_found_beside_noise_of_positions(tmp_path: Path) -> None:
    drive, noise = PathDrive(), np.random.default_rng(8)

    def message(t: float) -> Any:
        made = drive.odometry(t, "map")
        place, turn = made.pose.pose.position, made.pose.pose.orientation
        place.x, place.y = place.x + float(noise.normal(0, 0.05)), place.y + float(noise.normal(0, 0.05))
        turned(turn, frozen(t, yaw_of(turn)))
        return made

    run, calibration = drive.write(tmp_path, drive.lidar_topic(), FieldTopic("/odom", 0.1, 0.2, message))
    assert_refused(outcome_of(run, calibration, tmp_path / "labels"), "/odom")


def test_an_imu_that_writes_angles_for_a_quaternion_has_no_orientation(tmp_path: Path) -> None:
    drive = FieldDrive()

    def message(t: float) -> Any:
        made = drive.imu(t)
        turn = made.orientation
        turn.x, turn.y, turn.z, turn.w = 0.3, -0.8, float(np.rad2deg(yaw_of(turn))), 0.0
        return made

    fixes = FieldTopic("/gps/fix", 0.1, 0.2, drive.fix)
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), fixes, FieldTopic("/imu", 0.01, 0.2, message))
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == "GNS-306"
    assert "--odometry course:/gps/fix" in found.messages("GNS-306")
