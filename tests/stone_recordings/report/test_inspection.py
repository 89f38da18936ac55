"""An inspection says what is in a recording and what is wrong with it, and finds nothing where nothing is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stone_recordings.report.inspection import Inspection, inspect
from tests.stone_recordings.clocks.streams import clouds, every, inspected, stream
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
    assert record.pop("lidar_ground") is None
    assert record == {
        "duration_ns": 900 * MS,
        "topics": [
            {"name": name, "type": kind, "count": count, "role": role, "rate_hz": hz, "point_count": points, "gaps": []}
            for name, kind, count, role, hz, points in (
                ("/imu", IMU, 180, "imu", 200.0, 0),
                ("/lidar", POINT_CLOUD, 10, "lidar", 10.0, 1500),
                ("/odom", ODOMETRY, 18, "odometry", 20.0, 0),
            )
        ],
        "findings": [],
    }


def test_gaps_are_counted(tmp_path: Path) -> None:
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


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    inspection = _inspected(tmp_path, _stamped("/imu", IMU, _every(5 * MS, 20)))
    assert _codes(inspection) == [("TOP-101", ""), ("TOP-103", "")]
    odometry = _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    assert _codes(_inspected(tmp_path, _clouds(record=KITTI) + odometry)) == [("TOP-102", "/lidar")]
    other = cloud_payload(sweep(HESAI, 1500, 0, START_NS + 37_000 * MS), CloudText(stamp_ns=START_NS))
    inspection = _inspected(tmp_path, [Recorded("/lidar", POINT_CLOUD, START_NS, other), *odometry])
    assert _codes(inspection) == [("TOP-102", "/lidar")]
    assert "another clock" in inspection.findings[0].message
    messages = _clouds() + _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    assert _codes(_inspected(tmp_path, messages, use_chunking=False)) == [("BAG-011", "")]


def test_a_topic_that_lies_is_a_finding_and_the_others_are_still_inspected(tmp_path: Path) -> None:
    said = CloudText(point_step=12, row_step=120)
    lying = Recorded("/lidar", POINT_CLOUD, START_NS, cloud_payload(sweep(HESAI, 10), said))
    odometry = _stamped("/odom", ODOMETRY, _every(50 * MS, 18))
    inspection = _inspected(tmp_path, [lying, *odometry, Recorded("/imu", IMU, START_NS, b"\x00\x01")])
    assert {("MSG-303", "/lidar"), ("MSG-301", "/imu")} <= set(_codes(inspection))
    assert [topic.role for topic in inspection.topics] == ["imu", "other", "odometry"]
    assert ("TOP-101", "/lidar") in _codes(inspection)
    assert inspection.topics[2].timing.rate_hz == 20.0


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


SWEEPS, READINGS = every(100 * MS, 20), every(10 * MS, 200)
CODES = {"MSG-312", "TOP-115", "TIM-211"}


def _cloud(stamp_ns: int, points: int = 1200, frame_id: str = "lidar", shown_ns: int | None = None) -> Recorded:
    said = CloudText(stamp_ns=stamp_ns if shown_ns is None else shown_ns, frame_id=frame_id)
    return Recorded("/lidar", POINT_CLOUD, stamp_ns + 10 * MS, cloud_payload(sweep(HESAI, points, 0, stamp_ns), said))


def _readings(ahead_ns: int = 0) -> list[Recorded]:
    return stream("/imu", IMU, READINGS + ahead_ns, READINGS + MS)


def _told(inspection: Inspection) -> dict[tuple[str, str], str]:
    return {(one.code, one.topic): one.message for one in inspection.findings if one.code in CODES}


def test_a_sound_recording_lacks_nothing_and_a_head_that_is_cut_says_nothing(tmp_path: Path) -> None:
    assert _told(inspected(tmp_path, clouds(SWEEPS, SWEEPS + 10 * MS), _readings())) == {}
    sweeps = [_cloud(stamp_ns) for stamp_ns in SWEEPS.tolist()]
    whole = sweeps[4].payload
    for size in (12, 14, 16, 20, int(np.random.default_rng(1).integers(21, 40))):
        sweeps[4] = Recorded("/lidar", POINT_CLOUD, sweeps[4].log_time_ns, whole[:size])
        assert _told(inspected(tmp_path, sweeps, _readings())) == {}


@pytest.mark.parametrize("frame_id", ["l", "lidar", "hesai_lidar_top"])
def test_empty_clouds_are_counted_wherever_they_are(tmp_path: Path, frame_id: str) -> None:
    sweeps = [_cloud(stamp_ns, 0 if row in (0, 3) else 1200, frame_id) for row, stamp_ns in enumerate(SWEEPS.tolist())]
    told = _told(inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("MSG-312", "/lidar")]
    assert told["MSG-312", "/lidar"].startswith("2 of 20 clouds hold no point")


def test_messages_without_a_frame_are_counted(tmp_path: Path) -> None:
    sweeps = [_cloud(stamp_ns, frame_id="" if row < 5 else "lidar") for row, stamp_ns in enumerate(SWEEPS.tolist())]
    told = _told(inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("TOP-115", "/lidar")]
    assert told["TOP-115", "/lidar"].startswith("5 of 20 messages name no frame")


@pytest.mark.parametrize(("count", "begin_s", "step_ns"), [(1, 0, 0), (20, 0, 0), (3, 4, 100 * MS)])
def test_stamps_of_zero_or_from_before_a_clock_was_set_are_counted_be_it_all_of_them(tmp_path, count, begin_s, step_ns):
    """A topic whose stamps are all 0 is timed by the recorder; fifty years are no gap of a beat."""
    shown_ns = [begin_s * 1000 * MS + row * step_ns for row in range(count)] + [None] * (20 - count)
    sweeps = [_cloud(stamp_ns, shown_ns=shown) for stamp_ns, shown in zip(SWEEPS.tolist(), shown_ns, strict=True)]
    told = _told(inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("TIM-211", "/lidar")]
    said = f"{count} of 20 messages are stamped near 1970-01-01 (the first {begin_s}.000 s"
    assert told["TIM-211", "/lidar"].startswith(said)


def test_clocks_that_all_count_from_their_start_are_named_and_one_alone_once(tmp_path: Path) -> None:
    since_boot_ns = 55 * 1000 * MS - int(SWEEPS[0])
    sweeps = clouds(SWEEPS + since_boot_ns, SWEEPS + 10 * MS)
    told = _told(inspected(tmp_path, sweeps, _readings(since_boot_ns)))
    assert list(told) == [("TIM-211", "/imu"), ("TIM-211", "/lidar")]
    assert "begin 55.000 s after 1970-01-01" in told["TIM-211", "/lidar"]
    alone = inspected(tmp_path, clouds(SWEEPS, SWEEPS + 10 * MS), _readings(since_boot_ns))
    assert [one.code for one in alone.findings if one.topic == "/imu"] == ["TIM-202"]
