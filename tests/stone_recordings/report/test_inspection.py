"""An inspection says what is in a recording and what is wrong with it, and finds nothing where nothing is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType

from stone_recordings.bags.errors import CutBagError
from stone_recordings.messages.gps_time import unix_ns
from stone_recordings.report.inspection import Inspection, inspect
from tests.stone_recordings.writing import (
    HESAI,
    KITTI,
    POINT_CLOUD,
    START_NS,
    CloudText,
    Recorded,
    cloud_payload,
    header,
    random_message,
    serialised,
    sweep,
    write_mcap,
)

MS = 1_000_000
IMU, ODOMETRY, INSPVAX = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "novatel_oem7_msgs/msg/INSPVAX"
DELAY_NS = 30 * MS


def _stamped(topic: str, type_name: str, stamps_ns: list[int], **fields: Any) -> list[Recorded]:
    recorded = []
    for row, stamp_ns in enumerate(stamps_ns):
        message = random_message(type_name, np.random.default_rng(row), is_tame=True)
        message.header = header(stamp_ns, "frame")
        if type_name == ODOMETRY:
            message.child_frame_id = "base_link"
        for name, value in fields.items():
            setattr(message, name, value)
        recorded.append(Recorded(topic, type_name, START_NS + row * MS + DELAY_NS, serialised(message)))
    return recorded


def _clouds(
    topic: str = "/lidar", count: int = 10, record: np.dtype[np.void] = HESAI, shift_ns: int = 0
) -> list[Recorded]:
    stamps_ns = [START_NS + row * 100 * MS for row in range(count)]
    return [
        Recorded(
            topic,
            POINT_CLOUD,
            stamp_ns + DELAY_NS,
            cloud_payload(sweep(record, 1500, row, stamp_ns + shift_ns), CloudText(stamp_ns=stamp_ns + shift_ns)),
        )
        for row, stamp_ns in enumerate(stamps_ns)
    ]


def _every(period_ns: int, count: int, lost: tuple[int, ...] = ()) -> list[int]:
    return [START_NS + row * period_ns for row in range(count) if row not in lost]


def _inspected(path: Path, messages: list[Recorded], **options: Any) -> Inspection:
    return inspect(write_mcap(path / "run.mcap", messages, **options))


def _codes(inspection: Inspection) -> list[tuple[str, str]]:
    return [(finding.code, finding.topic) for finding in inspection.findings]


def test_a_sound_recording_has_roles_and_rates_and_no_findings(tmp_path: Path) -> None:
    messages = _clouds() + _stamped("/imu", IMU, _every(5 * MS, 180)) + _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    record = _inspected(tmp_path, messages).as_record()
    del record["clocks"]
    assert record.pop("channels") == {"lidar": "/lidar", "pose": "/odom", "imu": "/imu"}
    assert record == {
        "duration_ns": 900 * MS,
        "topics": [
            {"name": "/imu", "type": IMU, "count": 180, "role": "imu", "rate_hz": 200.0, "point_count": 0, "gaps": []},
            {
                "name": "/lidar",
                "type": POINT_CLOUD,
                "count": 10,
                "role": "lidar",
                "rate_hz": 10.0,
                "point_count": 1500,
                "gaps": [],
            },
            {
                "name": "/odom",
                "type": ODOMETRY,
                "count": 18,
                "role": "odometry",
                "rate_hz": 20.0,
                "point_count": 0,
                "gaps": [],
            },
        ],
        "findings": [],
    }


def test_two_lost_messages_are_a_gap_and_one_is_not(tmp_path: Path) -> None:
    """In header time: the log times of these messages are a millisecond apart throughout."""
    messages = _clouds() + _stamped("/imu", IMU, _every(5 * MS, 100, lost=(20, 50, 51)))
    messages += _stamped("/odom", ODOMETRY, _every(50 * MS, 18, lost=(7,)))
    inspection = _inspected(tmp_path, messages)
    imu, _lidar, odometry = inspection.as_record()["topics"]  # type: ignore[misc]
    start_ns, end_ns = START_NS + 49 * 5 * MS, START_NS + 52 * 5 * MS
    assert imu["gaps"] == [{"start_ns": start_ns, "end_ns": end_ns, "duration_ns": 15 * MS}]
    assert odometry["gaps"] == []
    assert _codes(inspection) == [("TIM-204", "/imu")]
    assert "the longest of 0.015 s" in inspection.findings[0].message


def test_stamps_that_step_back_are_counted(tmp_path: Path) -> None:
    stamps_ns = _every(5 * MS, 100)
    stamps_ns[40] -= 8 * MS
    stamps_ns[70] -= 12 * MS
    inspection = _inspected(
        tmp_path, _clouds() + _stamped("/imu", IMU, stamps_ns) + _stamped("/odom", ODOMETRY, _every(MS, 5))
    )
    assert _codes(inspection) == [("TIM-203", "/imu")]
    assert inspection.findings[0].message == "2 stamps go backwards (worst by 0.007000 s)."


def _ins(jitter_ns: int, offset_ns: int = 40 * MS) -> list[Recorded]:
    """GPS times every 50 ms, published late by an offset and a jitter."""
    recorded = []
    week, first_ms = 2289, 200_000
    generator = np.random.default_rng(1)
    for row in range(40):
        message = random_message(INSPVAX, np.random.default_rng(row), is_tame=True)
        gps_ns = int(unix_ns(np.array([week]), np.array([first_ms + 50 * row]))[0])
        message.nov_header.gps_week_number, message.nov_header.gps_week_milliseconds = week, first_ms + 50 * row
        message.pos_type.type = 56
        message.header = header(gps_ns + offset_ns + int(generator.normal(0, jitter_ns)), "gps")
        recorded.append(Recorded("/inspvax", INSPVAX, gps_ns + offset_ns, serialised(message)))
    return recorded


def test_novatel_stamped_on_the_host_is_told_from_stamped_by_the_receiver(tmp_path: Path) -> None:
    host = _inspected(tmp_path, _ins(jitter_ns=3 * MS))
    assert ("TIM-201", "/inspvax") in _codes(host)
    message = next(finding.message for finding in host.findings if finding.code == "TIM-201")
    assert "median offset 40." in message or "median offset 39." in message
    assert "TIM-201" not in {code for code, _topic in _codes(_inspected(tmp_path, _ins(jitter_ns=0)))}


def test_a_clock_that_counts_tai_is_told_by_its_37_seconds(tmp_path: Path) -> None:
    messages = _clouds() + _stamped("/odom", ODOMETRY, _every(MS, 18))
    messages += _stamped("/imu", IMU, [stamp_ns + 37_000 * MS for stamp_ns in _every(MS, 180)])
    inspection = _inspected(tmp_path, messages)
    assert _codes(inspection) == [("TIM-202", "/imu")]
    assert "by 37." in inspection.findings[0].message
    assert "TAI − UTC?" in inspection.findings[0].message


def test_a_recording_without_lidar_or_poses_says_which_is_missing(tmp_path: Path) -> None:
    inspection = _inspected(tmp_path, _stamped("/imu", IMU, _every(5 * MS, 20)))
    assert _codes(inspection) == [("TOP-101", ""), ("TOP-103", "")]


def test_packets_without_points_are_named(tmp_path: Path) -> None:
    frame = random_message("hesai_ros_driver/msg/UdpFrame", np.random.default_rng(0), is_tame=True)
    packets = [Recorded("/lidar_packets", "hesai_ros_driver/msg/UdpFrame", START_NS, serialised(frame))]
    inspection = _inspected(tmp_path, packets + _stamped("/odom", ODOMETRY, _every(50 * MS, 18)))
    assert _codes(inspection) == [("MSG-313", "/lidar_packets"), ("TOP-101", "/lidar_packets")]
    assert "raw packets: record /lidar_points of hesai_ros_driver" in inspection.findings[1].message


def test_points_without_time_and_points_of_another_clock_are_told(tmp_path: Path) -> None:
    odometry = _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    assert _codes(_inspected(tmp_path, _clouds(record=KITTI) + odometry)) == [("TOP-102", "/lidar")]
    other = cloud_payload(sweep(HESAI, 1500, 0, START_NS + 37_000 * MS), CloudText(stamp_ns=START_NS))
    inspection = _inspected(tmp_path, [Recorded("/lidar", POINT_CLOUD, START_NS, other), *odometry])
    assert _codes(inspection) == [("TOP-102", "/lidar")]
    assert "another clock" in inspection.findings[0].message


def test_two_lidars_are_a_choice_to_make(tmp_path: Path) -> None:
    odometry = _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    inspection = _inspected(tmp_path, _clouds("/left") + _clouds("/right") + odometry)
    assert _codes(inspection) == [("TOP-110", "/left")]
    assert "2 topics fit role lidar: /left, /right" in inspection.findings[0].message


def test_a_topic_that_lies_is_a_finding_and_the_others_are_still_inspected(tmp_path: Path) -> None:
    lying = Recorded("/lidar", POINT_CLOUD, START_NS, cloud_payload(sweep(HESAI, 10), CloudText(point_step=12)))
    odometry = _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    inspection = _inspected(tmp_path, [lying, *odometry, Recorded("/imu", IMU, START_NS, b"\x00\x01")])
    assert {("MSG-303", "/lidar"), ("MSG-301", "/imu")} <= set(_codes(inspection))
    assert [topic.role for topic in inspection.topics] == ["imu", "lidar", "odometry"]
    assert inspection.topics[2].timing.rate_hz == 20.0


def test_a_recording_without_index_is_told_that_it_was_walked(tmp_path: Path) -> None:
    messages = _clouds() + _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    assert _codes(_inspected(tmp_path, messages, use_chunking=False)) == [("BAG-011", "")]


def test_compression_changes_nothing(tmp_path: Path) -> None:
    messages = _clouds() + _stamped("/imu", IMU, _every(5 * MS, 100, lost=(50, 51)))
    records = [
        _inspected(tmp_path, messages, compression=compression, chunk_size=50_000).as_record()
        for compression in CompressionType
    ]
    assert records[0] == records[1] == records[2]


def test_a_recording_that_was_cut_is_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "run.mcap", _clouds())
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(CutBagError, match=r"run\.mcap was cut off at byte 1000"):
        inspect(path)


@pytest.mark.field_data
def test_the_real_recording_has_its_roles(field_data: Path) -> None:
    inspection = inspect(field_data / "kitti0005_ros2_mcap/kitti0005_lidar_odom.mcap")
    roles = {topic.topic.name: (topic.role, topic.topic.count) for topic in inspection.topics}
    assert roles == {
        "/odom": ("odometry", 154),
        "/tf": ("tf", 154),
        "/tf_static": ("tf_static", 1),
        "/velodyne_points": ("lidar", 154),
    }
    assert _codes(inspection) == [("TOP-102", "/velodyne_points")]
