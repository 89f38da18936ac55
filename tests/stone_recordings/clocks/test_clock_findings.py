"""Each fault of a clock is named, on the topic that has it, and on no other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone_recordings.clocks.constants import constant_of
from stone_recordings.report.inspection import inspect
from tests.stone_recordings.clocks.streams import (
    IMAGE,
    IMU,
    MS,
    clouds,
    every,
    inspected,
    radar_lists,
    sentence,
    solutions,
    stream,
    timing_codes,
)
from tests.stone_recordings.rigs import odometry
from tests.stone_recordings.writing import Recorded, random_message, serialised

S = 1_000 * MS
SWEEPS, READINGS, SHOTS = every(100 * MS, 40), every(10 * MS, 400), every(100 * MS, 40)


def _jitter(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 2 * MS, count)


def _rig(lidar_ns: int = 0, imu_ns: int = 0, camera_ns: int = 0) -> tuple[list[Recorded], ...]:
    """Three sensors whose clocks are ahead by so much, recorded with transport jitter."""
    return (
        clouds(SWEEPS + lidar_ns, SWEEPS + 105 * MS + _jitter(0, 40)),
        stream("/imu", IMU, READINGS + imu_ns, READINGS + 10 * MS + _jitter(1, 400)),
        stream("/camera/image", IMAGE, SHOTS + camera_ns, SHOTS + 30 * MS + _jitter(2, 40)),
        solutions("/ins", every(50 * MS, 80), np.full(80, 3 * MS)),
    )


def test_sound_clocks_with_transport_jitter_have_no_findings(tmp_path: Path) -> None:
    assert timing_codes(inspected(tmp_path, *_rig())) == []


def test_the_one_clock_that_is_ahead_is_named_be_it_the_lidars(tmp_path: Path) -> None:
    imu = inspected(tmp_path, *_rig(imu_ns=18 * S))
    assert timing_codes(imu) == [("TIM-202", "/imu")]
    assert "GPS − UTC" in sentence(imu, "TIM-202", "/imu")
    lidar = inspected(tmp_path, *_rig(lidar_ns=37 * S))
    assert timing_codes(lidar) == [("TIM-202", "/lidar")]
    assert "TAI − UTC" in sentence(lidar, "TIM-202", "/lidar")
    assert "Nothing was shifted" in sentence(lidar, "TIM-202", "/lidar")


def test_a_recording_that_was_replayed_years_later_has_one_clock_still(tmp_path: Path) -> None:
    ago_ns = -3 * 365 * 86_400 * S
    inspection = inspected(tmp_path, *_rig(ago_ns, ago_ns, ago_ns)[:3])
    assert timing_codes(inspection) == []


def test_a_receivers_gps_time_on_another_clock_than_the_rest_is_told(tmp_path: Path) -> None:
    """All stamps are the host's, but the host's clock is two hours off: the poses would be."""
    groups = _rig()[:3]
    times_ns = every(50 * MS, 80) - 7200 * S
    late_ns = np.full(80, 7200 * S + 3 * MS)
    inspection = inspected(tmp_path, *groups, solutions("/ins", times_ns, late_ns))
    assert timing_codes(inspection) == [("TIM-202", "/ins")]
    assert "GPS time" in sentence(inspection, "TIM-202", "/ins")
    assert "time zone" in sentence(inspection, "TIM-202", "/ins")


def test_a_clock_that_counts_from_its_start_is_recognised(tmp_path: Path) -> None:
    since_boot_ns = 55 * S - int(SWEEPS[0])
    inspection = inspected(tmp_path, *_rig(imu_ns=since_boot_ns))
    assert timing_codes(inspection) == [("TIM-202", "/imu")]
    assert "since boot" in sentence(inspection, "TIM-202", "/imu")


@pytest.mark.parametrize(
    ("ahead_s", "named"),
    [(37, "TAI-UTC"), (-37, "TAI-UTC"), (36.9, "TAI-UTC"), (18.1, "GPS-UTC"), (19, "TAI-GPS"), (3600, "time zone"),
     (-19_800, "time zone"), (0, ""), (5, ""), (36, ""), (51_000, ""), (30 * 3600, "")],
)  # fmt: skip
def test_known_constants_have_their_names_and_others_none(ahead_s: float, named: str) -> None:
    assert constant_of(round(ahead_s * S)) == named


def _run(drift_ppm: float, topic: str = "/radar") -> list[Recorded]:
    times_ns = every(500 * MS, 60)
    stamps_ns = times_ns + ((times_ns - times_ns[0]) * drift_ppm * 1e-6).astype(np.int64)
    lists = radar_lists(topic, stamps_ns, stamps_ns)
    return [
        Recorded(one.topic, one.type, int(time_ns) + 10 * MS, one.payload)
        for one, time_ns in zip(lists, times_ns, strict=True)
    ]


def test_the_radar_that_drifts_is_named_with_its_drift(tmp_path: Path) -> None:
    sweeps_ns = every(300 * MS, 100)
    lidar = clouds(sweeps_ns, sweeps_ns + 105 * MS)
    inspection = inspected(tmp_path, lidar, _run(50), _run(0, "/left"), _run(-4, "/right"))
    assert timing_codes(inspection) == [("TIM-207", "/radar")]
    assert "+50.0 ppm" in sentence(inspection, "TIM-207", "/radar")
    assert "3.00 ms a minute" in sentence(inspection, "TIM-207", "/radar")


def test_a_clock_that_seems_slow_may_have_been_heard_ever_later(tmp_path: Path) -> None:
    sweeps_ns = every(300 * MS, 100)
    lidar = clouds(sweeps_ns, sweeps_ns + 105 * MS)
    inspection = inspected(tmp_path, lidar, _run(-50), _run(0, "/left"))
    assert timing_codes(inspection) == [("TIM-207", "/radar")]
    assert "-50.0 ppm" in sentence(inspection, "TIM-207", "/radar")
    assert "or its messages came later and later" in sentence(inspection, "TIM-207", "/radar")


def test_odometry_that_takes_ever_longer_to_compute_accuses_no_clock(tmp_path: Path) -> None:
    sweeps_ns = every(300 * MS, 100)
    times_ns = sweeps_ns + 105 * MS
    slower_ns = times_ns + ((sweeps_ns - sweeps_ns[0]) * 300e-6).astype(np.int64)
    poses = [odometry(int(stamp_ns), SE3.identity()) for stamp_ns in sweeps_ns]
    late = [replace(one, log_time_ns=int(time_ns)) for one, time_ns in zip(poses, slower_ns, strict=True)]
    assert timing_codes(inspected(tmp_path, clouds(sweeps_ns, times_ns), _run(0), late)) == []


def test_a_recorder_whose_own_clock_drifts_accuses_no_sensor(tmp_path: Path) -> None:
    """All sensors drift alike against it."""
    sweeps_ns = every(300 * MS, 100)
    record_ns = sweeps_ns + ((sweeps_ns - sweeps_ns[0]) * -60e-6).astype(np.int64)
    lidar = clouds(sweeps_ns, record_ns + 105 * MS)
    assert timing_codes(inspected(tmp_path, lidar, _run(60), _run(60, "/left"))) == []


def test_a_drift_that_jitter_explains_is_not_told(tmp_path: Path) -> None:
    sweeps_ns = every(100 * MS, 60)
    lidar = clouds(sweeps_ns, sweeps_ns + 105 * MS + np.random.default_rng(4).integers(0, 8 * MS, 60))
    report = inspected(tmp_path, lidar, _run(0), _run(0, "/left"))
    assert timing_codes(report) == []
    assert abs(next(clock.drift_ppm or 0 for clock in report.clocks.topics if clock.topic == "/lidar")) > 20


def test_images_that_are_missing_from_a_strict_beat_are_dropped_triggers(tmp_path: Path) -> None:
    kept = np.setdiff1d(np.arange(40), [7, 15, 16, 30])
    lidar, imu, _camera, ins = _rig()
    camera = stream("/camera/image", IMAGE, SHOTS[kept], SHOTS[kept] + 30 * MS)
    inspection = inspected(tmp_path, lidar, imu, camera, ins)
    assert timing_codes(inspection) == [("TIM-204", "/camera/image"), ("TIM-208", "/camera/image")]
    assert "4 of 40 triggers" in sentence(inspection, "TIM-208", "/camera/image")


def test_images_without_a_beat_have_no_dropped_triggers(tmp_path: Path) -> None:
    lidar, imu, _camera, ins = _rig()
    shots_ns = SHOTS[0] + np.cumsum(np.random.default_rng(0).integers(20 * MS, 180 * MS, 40))
    inspection = inspected(tmp_path, lidar, imu, stream("/camera/image", IMAGE, shots_ns, shots_ns + 30 * MS), ins)
    assert timing_codes(inspection) == []


LOG, DIAGNOSTICS, STRING = "rcl_interfaces/msg/Log", "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/String"


@pytest.mark.parametrize("within_ns", [5_570, 5 * MS, 40 * MS])
@pytest.mark.parametrize("type_name", [LOG, DIAGNOSTICS, STRING])
def test_what_comes_in_bursts_has_neither_gaps_nor_the_rate_of_its_bursts(
    type_name: str, within_ns: int, tmp_path: Path
) -> None:
    """Nodes write some lines at once, and then none for seconds: no 179533 Hz with gaps."""
    bursts_ns = (every(2 * S, 5)[:, None] + np.arange(8) * within_ns).ravel()
    log = Recorded("/rosout", type_name, 0, serialised(random_message(type_name, np.random.default_rng(3))))
    lines = (
        stream("/rosout", DIAGNOSTICS, bursts_ns, bursts_ns)
        if type_name == DIAGNOSTICS
        else [replace(log, log_time_ns=time_ns) for time_ns in bursts_ns.tolist()]
    )
    inspection = inspected(tmp_path, *_rig(), lines)
    assert [found for found in inspection.findings if found.topic == "/rosout"] == []
    [rate_hz] = [part.timing.rate_hz for part in inspection.topics if part.topic.name == "/rosout"]
    assert rate_hz is None or rate_hz < 10_000


def test_a_sensor_that_was_silent_for_most_of_a_recording_has_a_gap_and_so_has_a_steady_topic_without_stamps(
    tmp_path: Path,
) -> None:
    stamps_ns = np.concatenate([READINGS, READINGS + 60 * S])
    beats_ns = np.delete(every(100 * MS, 600), slice(100, 120))
    text = serialised(random_message(STRING, np.random.default_rng(3)))
    beats = [Recorded("/heartbeat", STRING, time_ns, text) for time_ns in beats_ns.tolist()]
    inspection = inspected(tmp_path, stream("/imu", IMU, stamps_ns, stamps_ns + 10 * MS), beats)
    assert timing_codes(inspection) == [("TIM-204", "/heartbeat"), ("TIM-204", "/imu")]


def test_repeated_stamps_are_counted(tmp_path: Path) -> None:
    lidar, _imu, camera, ins = _rig()
    stamps_ns = READINGS.copy()
    stamps_ns[100] = stamps_ns[99]
    inspection = inspected(tmp_path, lidar, camera, ins, stream("/imu", IMU, stamps_ns, READINGS + 10 * MS))
    assert timing_codes(inspection) == [("TIM-206", "/imu")]
    assert sentence(inspection, "TIM-206", "/imu").startswith("1 of 400 messages repeat a stamp")


def test_a_radar_that_was_never_synchronised_says_so_itself(tmp_path: Path) -> None:
    lidar, imu, camera, ins = _rig()
    stamps_ns = every(50 * MS, 80)
    radar = radar_lists("/radar", stamps_ns, stamps_ns - stamps_ns[0], status=2)
    inspection = inspected(tmp_path, lidar, imu, camera, ins, radar)
    assert timing_codes(inspection) == [("TIM-210", "/radar")]
    assert "80 of 80" in sentence(inspection, "TIM-210", "/radar")


def test_a_receiver_that_lies_about_its_lengths_is_a_finding_and_the_rest_is_measured(tmp_path: Path) -> None:
    lidar, imu, camera, ins = _rig()
    short = [Recorded(one.topic, one.type, one.log_time_ns, one.payload[:24]) for one in ins]
    inspection = inspected(tmp_path, lidar, imu, camera, short)
    assert ("MSG-301", "/ins") in [(found.code, found.topic) for found in inspection.findings]
    assert [clock.topic for clock in inspection.clocks.topics] == ["/camera/image", "/imu", "/ins", "/lidar"]


@pytest.mark.field_data
def test_the_real_recording_has_sound_clocks(field_data: Path) -> None:
    inspection = inspect(field_data / "kitti0005_ros2_mcap/kitti0005_lidar_odom.mcap")
    assert timing_codes(inspection) == []
    clocks = {clock.topic: clock for clock in inspection.clocks.topics}
    assert {name: clock.stamp_source for name, clock in clocks.items()} == {
        "/odom": "sensor",
        "/tf": "recorder",
        "/tf_static": "recorder",
        "/velodyne_points": "sensor",
    }
    assert clocks["/velodyne_points"].offset_ns == 40 * MS


@pytest.mark.field_data
def test_a_receivers_log_that_was_replayed_is_told_by_its_gps_time(field_data: Path) -> None:
    """Recorded in August 2021 of what the receiver said in April 2020, in bursts."""
    inspection = inspect(field_data / "novatel_oem7/ins2_ros2_mcap/ins2_ros2_mcap.mcap")
    assert {("TIM-201", "/novatel/oem7/inspvax"), ("TIM-202", "/novatel/oem7/inspvax")} <= set(timing_codes(inspection))
    assert "-41617252." in sentence(inspection, "TIM-202", "/novatel/oem7/inspvax")
