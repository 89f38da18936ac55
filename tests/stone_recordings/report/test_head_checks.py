"""What the heads of messages lack is found in the whole recording, on the topic that lacks it, and nowhere else."""

from pathlib import Path

import numpy as np
import pytest

from stone_recordings.report.inspection import Inspection, inspect
from tests.stone_recordings.clocks.streams import IMU, MS, clouds, every, stream
from tests.stone_recordings.writing import HESAI, CloudText, Recorded, cloud_payload, sweep, write_mcap

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
SWEEPS, READINGS = every(100 * MS, 20), every(10 * MS, 200)
CODES = {"MSG-312", "TOP-115", "TIM-211"}


def _cloud(stamp_ns: int, points: int = 1200, frame_id: str = "lidar", shown_ns: int | None = None) -> Recorded:
    said = CloudText(stamp_ns=stamp_ns if shown_ns is None else shown_ns, frame_id=frame_id)
    return Recorded("/lidar", POINT_CLOUD, stamp_ns + 10 * MS, cloud_payload(sweep(HESAI, points, 0, stamp_ns), said))


def _readings(ahead_ns: int = 0) -> list[Recorded]:
    return stream("/imu", IMU, READINGS + ahead_ns, READINGS + MS)


def _inspected(path: Path, *groups: list[Recorded]) -> Inspection:
    messages = sorted((message for group in groups for message in group), key=lambda message: message.log_time_ns)
    return inspect(write_mcap(path / "run.mcap", messages))


def _told(inspection: Inspection) -> dict[tuple[str, str], str]:
    return {(one.code, one.topic): one.message for one in inspection.findings if one.code in CODES}


def test_a_sound_recording_lacks_nothing(tmp_path: Path) -> None:
    assert _told(_inspected(tmp_path, clouds(SWEEPS, SWEEPS + 10 * MS), _readings())) == {}


@pytest.mark.parametrize("frame_id", ["l", "lidar", "hesai_lidar_top"])
def test_empty_clouds_are_counted_wherever_they_are(tmp_path: Path, frame_id: str) -> None:
    sweeps = [_cloud(stamp_ns, 0 if row in (0, 3) else 1200, frame_id) for row, stamp_ns in enumerate(SWEEPS.tolist())]
    told = _told(_inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("MSG-312", "/lidar")]
    assert told["MSG-312", "/lidar"].startswith("2 of 20 clouds hold no point")


def test_messages_without_a_frame_are_counted(tmp_path: Path) -> None:
    sweeps = [_cloud(stamp_ns, frame_id="" if row < 5 else "lidar") for row, stamp_ns in enumerate(SWEEPS.tolist())]
    told = _told(_inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("TOP-115", "/lidar")]
    assert told["TOP-115", "/lidar"].startswith("5 of 20 messages name no frame")


@pytest.mark.parametrize("count", [1, 20])
def test_stamps_of_zero_are_counted_be_it_all_of_them(tmp_path: Path, count: int) -> None:
    """A topic whose stamps are all 0 is timed by the recorder, and that was not said."""
    stamps = enumerate(SWEEPS.tolist())
    sweeps = [_cloud(stamp_ns, shown_ns=0 if row < count else None) for row, stamp_ns in stamps]
    told = _told(_inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("TIM-211", "/lidar")]
    assert told["TIM-211", "/lidar"].startswith(
        f"{count} of 20 messages are stamped near 1970-01-01 (the first 0.000 s"
    )


def test_stamps_from_before_a_clock_was_set_are_counted(tmp_path: Path) -> None:
    """They lie fifty years before the others, which no gap of a beat is told of."""
    stamps = enumerate(SWEEPS.tolist())
    sweeps = [
        _cloud(stamp_ns, shown_ns=4 * 1000 * MS + row * 100 * MS if row < 3 else None) for row, stamp_ns in stamps
    ]
    told = _told(_inspected(tmp_path, sweeps, _readings()))
    assert list(told) == [("TIM-211", "/lidar")]
    assert told["TIM-211", "/lidar"].startswith("3 of 20 messages are stamped near 1970-01-01 (the first 4.000 s")


def test_clocks_that_all_count_from_their_start_are_named_and_one_alone_once(tmp_path: Path) -> None:
    since_boot_ns = 55 * 1000 * MS - int(SWEEPS[0])
    sweeps = clouds(SWEEPS + since_boot_ns, SWEEPS + 10 * MS)
    told = _told(_inspected(tmp_path, sweeps, _readings(since_boot_ns)))
    assert list(told) == [("TIM-211", "/imu"), ("TIM-211", "/lidar")]
    assert "begin 55.000 s after 1970-01-01" in told["TIM-211", "/lidar"]
    alone = _inspected(tmp_path, clouds(SWEEPS, SWEEPS + 10 * MS), _readings(since_boot_ns))
    assert [one.code for one in alone.findings if one.topic == "/imu"] == ["TIM-202"]


def test_a_head_that_is_cut_says_nothing(tmp_path: Path) -> None:
    sweeps = [_cloud(stamp_ns) for stamp_ns in SWEEPS.tolist()]
    whole = sweeps[4].payload
    for size in (12, 14, 16, 20, int(np.random.default_rng(1).integers(21, 40))):
        sweeps[4] = Recorded("/lidar", POINT_CLOUD, sweeps[4].log_time_ns, whole[:size])
        assert _told(_inspected(tmp_path, sweeps, _readings())) == {}
