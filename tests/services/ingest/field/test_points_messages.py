"""Sweeps that were recorded as other messages of points than PointCloud2 give the labels of their sound twin."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testing.worlds.field.drive import FieldDrive, FieldTopic
from testing.worlds.field.outcome import FieldOutcome, labelled_frames, occupied_iou, outcome_of
from testing.worlds.field.point_messages import (
    COMPRESSED,
    COMPRESSED_FIELDS,
    compressed_message,
    livox_definitions,
    livox_message,
    topic,
)
from testing.worlds.ros1_bags import as_ros1

Message = Callable[[FieldDrive, float], Any]
SWEEPS, SAME = 16, 0.97
BOOT_NS = 668_000_000_000


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    drive = FieldDrive(sweeps=SWEEPS)
    run, calibration = drive.write(folder, drive.lidar_topic(), drive.odometry_topic())
    assert outcome_of(run, calibration, folder / "labels").refusal == ""
    return folder / "labels"


def drive_of(package: str = "livox_ros_driver2") -> FieldDrive:
    return FieldDrive(sweeps=SWEEPS, definitions=(*livox_definitions(package), (COMPRESSED, COMPRESSED_FIELDS)))


def labelled(folder: Path, drive: FieldDrive, *lidars: FieldTopic, is_ros1: bool = False) -> FieldOutcome:
    run, calibration = drive.write(folder, *lidars, drive.odometry_topic())
    if is_ros1:
        run = as_ros1(next(run.glob("*.mcap")), folder / "run.bag")
    return outcome_of(run, calibration, folder / "labels")


def assert_alike(found: FieldOutcome, sound: Path, frames: int = SWEEPS) -> None:
    assert (found.refusal, found.errors) == ("", [])
    assert found.labels is not None
    assert len(labelled_frames(found.labels)) == frames
    if frames == SWEEPS:
        assert occupied_iou(found.labels, sound) >= SAME


@pytest.mark.parametrize(
    ("package", "timebase_ns", "is_ros1"),
    [
        ("livox_ros_driver2", None, False),
        ("livox_ros_driver2", 0, False),
        ("livox_ros_driver", BOOT_NS, False),
        ("livox_ros_driver", None, True),
        ("livox_interfaces", None, False),
    ],
)
def test_livox_points_are_labelled(
    tmp_path: Path, sound: Path, package: str, timebase_ns: int | None, is_ros1: bool
) -> None:
    drive = drive_of(package)

    def message(t: float) -> Any:
        return livox_message(drive, t, timebase_ns, package, point_num=1)

    found = labelled(tmp_path, drive, topic("/livox/lidar", message), is_ros1=is_ros1)
    assert_alike(found, sound)


@pytest.mark.parametrize("packer", ["zlib", "zlib with its own header", "zstd"])
def test_compressed_points_are_labelled(tmp_path: Path, sound: Path, packer: str) -> None:
    drive = drive_of()
    found = labelled(tmp_path, drive, topic("/points/packed", lambda t: compressed_message(drive, t, packer)))
    assert_alike(found, sound)


def test_compressed_points_beside_the_cloud_leave_no_choice(tmp_path: Path, sound: Path) -> None:
    drive = drive_of()
    beside = topic("/points/zstd", lambda t: compressed_message(drive, t, "zstd"))
    assert_alike(labelled(tmp_path, drive, drive.lidar_topic(), beside), sound)


def livox_broken_once(drive: FieldDrive, t: float) -> Any:
    if round(t * 10) != 9:
        return livox_message(drive, t)
    return livox_message(drive, t, points=[])


def packed_broken_once(drive: FieldDrive, t: float) -> Any:
    message = compressed_message(drive, t, "zlib")
    if round(t * 10) == 9:
        message.compressed_data = message.compressed_data[:-4000]
    return message


@pytest.mark.parametrize(("message", "code"), [(livox_broken_once, "MSG-312"), (packed_broken_once, "MSG-303")])
def test_a_sweep_without_points_costs_its_frame_alone(tmp_path: Path, sound: Path, message: Message, code: str) -> None:
    drive = drive_of()
    found = labelled(tmp_path, drive, topic("/lidar", lambda t: message(drive, t)))
    assert_alike(found, sound, frames=SWEEPS - 1)
    assert code in found.codes


NAMED = {
    "draco": (COMPRESSED, "republish"),
    "ouster": ("ouster_sensor_msgs/msg/PacketMsg", "/ouster/points"),
    "robosense": ("rslidar_msg/msg/RslidarPacket", "/rslidar_points"),
    "plane": ("sensor_msgs/msg/LaserScan", "one plane"),
}


def unread_topic(kind: str, drive: FieldDrive) -> FieldTopic:
    name = NAMED[kind][0]
    if kind == "draco":
        return topic("/unread", lambda t: compressed_message(drive, t, "draco"))
    if kind == "plane":
        values = (-1.0, 1.0, 0.1, 0.0, 0.1, 0.1, 30.0, np.ones(20, np.float32), np.zeros(0, np.float32))
        return topic("/unread", lambda t: drive.of(name, drive.header(t, "laser"), *values))
    if kind == "ouster":
        return topic("/unread", lambda t: drive.of(name, np.zeros(64, np.uint8)))
    return topic("/unread", lambda t: drive.of(name, drive.header(t, "rs"), 0, 0, np.zeros(64, np.uint8)))


PACKETS = (
    ("ouster_sensor_msgs/msg/PacketMsg", "uint8[] buf"),
    ("rslidar_msg/msg/RslidarPacket", "std_msgs/Header header\nuint8 is_difop\nuint8 is_frame_begin\nuint8[] data"),
)


@pytest.mark.parametrize("kind", NAMED)
def test_what_is_not_read_is_named_by_topic_and_type_with_a_way_out(tmp_path: Path, kind: str) -> None:
    type_name, way_out = NAMED[kind]
    drive = FieldDrive(sweeps=SWEEPS, definitions=((COMPRESSED, COMPRESSED_FIELDS), *PACKETS))
    alone = labelled(tmp_path / "alone", drive, unread_topic(kind, drive))
    assert alone.refusal == "TOP-101"
    for word in ("/unread", type_name, way_out):
        assert word in alone.messages("TOP-101")
    beside = labelled(tmp_path / "beside", drive, drive.lidar_topic(), unread_topic(kind, drive))
    assert (beside.refusal, beside.errors) == ("", [])
    named = [finding for finding in beside.findings if finding.topic == "/unread"]
    assert any(way_out in finding.message for finding in named)
    assert {finding.severity for finding in named} <= {"info", "warning"}
