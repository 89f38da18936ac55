"""Each fault of a clock is named, on the topic that has it, and on no other."""

from dataclasses import replace
from itertools import cycle
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
    Stamps,
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


def test_sound_clocks_have_no_findings_nor_one_recording_that_was_replayed_years_later(tmp_path: Path) -> None:
    assert timing_codes(inspected(tmp_path, *_rig())) == []
    ago_ns = -3 * 365 * 86_400 * S
    inspection = inspected(tmp_path, *_rig(ago_ns, ago_ns, ago_ns)[:3])
    assert timing_codes(inspection) == []


def test_the_one_clock_that_is_ahead_or_counts_from_its_start_is_named(tmp_path: Path) -> None:
    imu = inspected(tmp_path, *_rig(imu_ns=18 * S))
    assert timing_codes(imu) == [("TIM-202", "/imu")]
    lidar = inspected(tmp_path, *_rig(lidar_ns=37 * S))
    assert timing_codes(lidar) == [("TIM-202", "/lidar")]
    since_boot_ns = 55 * S - int(SWEEPS[0])
    inspection = inspected(tmp_path, *_rig(imu_ns=since_boot_ns))
    assert timing_codes(inspection) == [("TIM-202", "/imu")]
    # All stamps are the host's, but the host's clock is two hours off: the poses would be.
    groups = _rig()[:3]
    times_ns = every(50 * MS, 80) - 7200 * S
    late_ns = np.full(80, 7200 * S + 3 * MS)
    inspection = inspected(tmp_path, *groups, solutions("/ins", times_ns, late_ns))
    assert timing_codes(inspection) == [("TIM-202", "/ins")]


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


@pytest.mark.whole
def test_a_recorder_that_drifts_and_odometry_that_takes_ever_longer_accuse_no_clock(tmp_path: Path) -> None:
    sweeps_ns = every(300 * MS, 100)
    times_ns = sweeps_ns + 105 * MS
    slower_ns = times_ns + ((sweeps_ns - sweeps_ns[0]) * 300e-6).astype(np.int64)
    poses = [odometry(int(stamp_ns), SE3.identity()) for stamp_ns in sweeps_ns]
    late = [replace(one, log_time_ns=int(time_ns)) for one, time_ns in zip(poses, slower_ns, strict=True)]
    assert timing_codes(inspected(tmp_path, clouds(sweeps_ns, times_ns), _run(0), late)) == []
    # All sensors drift alike against it.
    record_ns = sweeps_ns + ((sweeps_ns - sweeps_ns[0]) * -60e-6).astype(np.int64)
    lidar = clouds(sweeps_ns, record_ns + 105 * MS)
    assert timing_codes(inspected(tmp_path, lidar, _run(60), _run(60, "/left"))) == []
    sweeps_ns = every(100 * MS, 60)
    lidar = clouds(sweeps_ns, sweeps_ns + 105 * MS + np.random.default_rng(4).integers(0, 8 * MS, 60))
    report = inspected(tmp_path, lidar, _run(0), _run(0, "/left"))
    assert timing_codes(report) == []
    assert abs(next(clock.drift_ppm or 0 for clock in report.clocks.topics if clock.topic == "/lidar")) > 20


def test_dropped_triggers_are_told_where_images_have_a_beat(tmp_path: Path) -> None:
    kept = np.setdiff1d(np.arange(40), [7, 15, 16, 30])
    lidar, imu, _camera, ins = _rig()
    camera = stream("/camera/image", IMAGE, SHOTS[kept], SHOTS[kept] + 30 * MS)
    inspection = inspected(tmp_path, lidar, imu, camera, ins)
    assert timing_codes(inspection) == [("TIM-204", "/camera/image"), ("TIM-208", "/camera/image")]
    assert "4 of 40 triggers" in sentence(inspection, "TIM-208", "/camera/image")
    shots_ns = SHOTS[0] + np.cumsum(np.random.default_rng(0).integers(20 * MS, 180 * MS, 40))
    inspection = inspected(tmp_path, lidar, imu, stream("/camera/image", IMAGE, shots_ns, shots_ns + 30 * MS), ins)
    assert timing_codes(inspection) == []


LOG, DIAGNOSTICS, STRING = "rcl_interfaces/msg/Log", "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/String"


@pytest.mark.parametrize("within_ns", [5_570, 40 * MS])
@pytest.mark.parametrize("type_name", [LOG, DIAGNOSTICS, STRING])
def test_what_comes_in_bursts_has_neither_gaps_nor_the_rate_of_its_bursts(type_name, within_ns, tmp_path):
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
    assert rate_hz == pytest.approx(39 / (8 + 7 * within_ns / 1e9))


@pytest.mark.parametrize("type_name", [LOG, DIAGNOSTICS])
def test_a_log_that_is_one_burst_has_its_count_over_the_time_of_the_recording(type_name: str, tmp_path: Path) -> None:
    """A node writes 35 lines within 70 ms as it starts: these are no 507 Hz with a gap."""
    lines_ns = every(2 * MS, 35)
    lines_ns[-1] += 30 * MS
    log = Recorded("/rosout", type_name, 0, serialised(random_message(type_name, np.random.default_rng(3))))
    lines = (
        stream("/rosout", DIAGNOSTICS, lines_ns, lines_ns)
        if type_name == DIAGNOSTICS
        else [replace(log, log_time_ns=time_ns) for time_ns in lines_ns.tolist()]
    )
    inspection = inspected(tmp_path, *_rig(), lines)
    [timing] = [part.timing for part in inspection.topics if part.topic.name == "/rosout"]
    assert timing.rate_hz == pytest.approx(35 / (inspection.duration_ns / 1e9))
    assert timing.gaps == ()


def test_the_rate_of_a_radar_that_publishes_in_pairs_is_its_count_over_its_time(tmp_path: Path) -> None:
    stamps_ns = (every(110 * MS, 17)[:, None] + np.array([0, 930_000])).ravel()
    inspection = inspected(tmp_path, *_rig(), radar_lists("/radar", stamps_ns, stamps_ns))
    [radar] = [part.timing for part in inspection.topics if part.topic.name == "/radar"]
    assert radar.rate_hz == pytest.approx(33 / 1.760_93)
    assert radar.gaps == ()


def test_a_sensor_that_was_silent_for_most_of_a_recording_has_a_gap_and_so_has_a_steady_topic_without_stamps(tmp_path):
    stamps_ns = np.concatenate([READINGS, READINGS + 60 * S])
    beats_ns = np.delete(every(100 * MS, 600), slice(100, 120))
    text = serialised(random_message(STRING, np.random.default_rng(3)))
    beats = [Recorded("/heartbeat", STRING, time_ns, text) for time_ns in beats_ns.tolist()]
    inspection = inspected(tmp_path, stream("/imu", IMU, stamps_ns, stamps_ns + 10 * MS), beats)
    assert timing_codes(inspection) == [("TIM-204", "/heartbeat"), ("TIM-204", "/imu")]


def test_repeated_stamps_are_counted_and_a_radar_without_sync_says_so_itself(tmp_path: Path) -> None:
    lidar, _imu, camera, ins = _rig()
    stamps_ns = READINGS.copy()
    stamps_ns[100] = stamps_ns[99]
    inspection = inspected(tmp_path, lidar, camera, ins, stream("/imu", IMU, stamps_ns, READINGS + 10 * MS))
    assert timing_codes(inspection) == [("TIM-206", "/imu")]
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


SWEEPS, READINGS, LATE_SHOTS = (every(100 * MS, 40), every(10 * MS, 400), every(100 * MS, 30) + 1 * S)
RADAR_NS = every(50 * MS, 60)
JUMPS_S = (3600.0, -3600.0, 1.7, -1.7, 50_000.0)


def _logged(times_ns: Stamps, jumps: dict[int, float]) -> Stamps:
    """What a recorder writes down whose clock jumps by so many seconds at these times."""
    steps = [np.where(times_ns >= SWEEPS[0] + at_ns, round(size_s * S), 0) for at_ns, size_s in jumps.items()]
    return times_ns + np.sum(steps, axis=0, dtype=np.int64)


def _jumping_rig(jumps: dict[int, float], imu_ahead: Stamps | int = 0) -> tuple[list[Recorded], ...]:
    """Three sensors, of which the camera begins late, so that most of its messages come after a jump."""
    jitter = np.random.default_rng(0).integers(0, 2 * MS, 400)
    return (
        clouds(SWEEPS, _logged(SWEEPS + 105 * MS + jitter[:40], jumps)),
        stream("/imu", IMU, READINGS + imu_ahead, _logged(READINGS + 10 * MS + jitter, jumps)),
        stream("/camera/image", IMAGE, LATE_SHOTS, _logged(LATE_SHOTS + 30 * MS + jitter[:30], jumps)),
    )


@pytest.mark.parametrize(("size_s", "at_ns"), list(zip(JUMPS_S, cycle([1_700 * MS, 2_620 * MS]), strict=False)))
def test_the_jump_is_named_and_no_sensor(tmp_path: Path, at_ns: int, size_s: float) -> None:
    inspection = inspected(tmp_path, *_jumping_rig({at_ns: size_s}))
    assert timing_codes(inspection) == [("TIM-212", "")]
    told = sentence(inspection, "TIM-212", "").removeprefix("The recorder's clock jumped by ")
    assert "jump with it" not in told
    assert float(told.partition(" s at ")[0]) == pytest.approx(size_s, abs=0.005)
    assert "time zone" not in " ".join(one.message for one in inspection.findings)
    offsets = {clock.topic: clock.offset_ns or 0 for clock in inspection.clocks.topics}
    assert all(0 < offset_ns < 200 * MS for offset_ns in offsets.values())


def test_two_jumps_are_two_and_a_recorder_that_caught_up_did_not_jump(tmp_path: Path) -> None:
    inspection = inspected(tmp_path, *_jumping_rig({1_500 * MS: 3600.0, 2_900 * MS: 7200.0}))
    assert timing_codes(inspection) == [("TIM-212", ""), ("TIM-212", "")]
    # For 1.6 s it took nothing, then all that had waited at once.
    stop_ns, go_ns = SWEEPS[0] + 1 * S, SWEEPS[0] + 2_600 * MS
    held = {}
    for name, times_ns in (("lidar", SWEEPS), ("imu", READINGS), ("camera", LATE_SHOTS)):
        late_ns = times_ns + 10 * MS
        held[name] = np.where((late_ns > stop_ns) & (late_ns < go_ns), go_ns + (late_ns - stop_ns) // 1000, late_ns)
    groups = (
        clouds(SWEEPS, held["lidar"]),
        stream("/imu", IMU, READINGS, held["imu"]),
        stream("/camera/image", IMAGE, LATE_SHOTS, held["camera"]),
    )
    assert "TIM-212" not in [code for code, _topic in timing_codes(inspected(tmp_path, *groups))]


@pytest.mark.parametrize(("size_s", "at_ns"), [(-3600.0, 1_700 * MS), (1.7, 2_620 * MS), (50_000.0, 1_700 * MS)])
@pytest.mark.parametrize("has_imu", [True, False])
def test_what_the_recorders_host_stamps_jumps_with_it_and_is_named(tmp_path, at_ns, size_s, has_imu):
    """The LiDAR and the IMU keep time, the poses are stamped by the clock that jumps: they meet no sweep after it."""
    lidar, imu, _camera = _jumping_rig({at_ns: size_s})
    published_ns = _logged(every(50 * MS, 80) + 20 * MS, {at_ns: size_s})
    poses = [
        replace(odometry(stamp_ns, SE3.identity()), log_time_ns=stamp_ns + MS) for stamp_ns in published_ns.tolist()
    ]
    inspection = inspected(tmp_path, lidar, *[imu] * has_imu, poses)
    codes = timing_codes(inspection)
    assert set(codes) - {("TIM-204", "/odom"), ("TIM-206", "/odom")} == {("TIM-212", "")}
    told = sentence(inspection, "TIM-212", "")
    assert "against the stamps of /imu, /lidar." in told or not has_imu
    assert "Those of /odom jump with it" in told


@pytest.mark.parametrize("size_s", [1.7, -3600.0])
def test_a_sensor_whose_own_clock_jumps_is_not_the_recorder(tmp_path: Path, size_s: float) -> None:
    ahead = np.where(np.arange(400) >= 250, round(size_s * S), 0)
    inspection = inspected(tmp_path, *_jumping_rig({}, ahead))
    assert "TIM-212" not in [code for code, _topic in timing_codes(inspection)]


def test_a_recorder_that_is_hours_off_from_the_start_names_no_time_zone(tmp_path: Path) -> None:
    """The radar is 3 s apart from the others: that is no time zone, though the recorder's distance from it is one."""
    off = {-10 * S: 3603.0}
    radar = radar_lists("/radar", RADAR_NS + 3 * S, RADAR_NS)
    late = [Recorded(one.topic, one.type, time_ns, one.payload) for one, time_ns in
            zip(radar, _logged(RADAR_NS + 10 * MS, off).tolist(), strict=True)]  # fmt: skip
    inspection = inspected(tmp_path, *_jumping_rig(off), late)
    assert "by 3.0" in sentence(inspection, "TIM-202", "/radar")
    assert "time zone" not in " ".join(one.message for one in inspection.findings)
