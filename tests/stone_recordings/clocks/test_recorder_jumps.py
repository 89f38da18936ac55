"""A recorder whose clock jumps while it records accuses no sensor, whatever the size of its jump."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stone.geometry.se3 import SE3
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
    stream,
    timing_codes,
)
from tests.stone_recordings.rigs import odometry
from tests.stone_recordings.writing import Recorded

S = 1_000 * MS
SWEEPS, READINGS, SHOTS = every(100 * MS, 40), every(10 * MS, 400), every(100 * MS, 30) + 1 * S
RADAR_NS = every(50 * MS, 60)
JUMPS_S = (3600.0, 7200.0, -3600.0, 1.7, -1.7, 18.0, 50_000.0)


def _logged(times_ns: Stamps, jumps: dict[int, float]) -> Stamps:
    """What a recorder writes down whose clock jumps by so many seconds at these times."""
    steps = [np.where(times_ns >= SWEEPS[0] + at_ns, round(size_s * S), 0) for at_ns, size_s in jumps.items()]
    return times_ns + np.sum(steps, axis=0, dtype=np.int64)


def _rig(jumps: dict[int, float], imu_ahead: Stamps | int = 0) -> tuple[list[Recorded], ...]:
    """Three sensors, of which the camera begins late, so that most of its messages come after a jump."""
    jitter = np.random.default_rng(0).integers(0, 2 * MS, 400)
    return (
        clouds(SWEEPS, _logged(SWEEPS + 105 * MS + jitter[:40], jumps)),
        stream("/imu", IMU, READINGS + imu_ahead, _logged(READINGS + 10 * MS + jitter, jumps)),
        stream("/camera/image", IMAGE, SHOTS, _logged(SHOTS + 30 * MS + jitter[:30], jumps)),
    )


@pytest.mark.parametrize("size_s", JUMPS_S)
@pytest.mark.parametrize("at_ns", [1_700 * MS, 2_100 * MS, 2_620 * MS])
def test_the_jump_is_named_and_no_sensor(tmp_path: Path, at_ns: int, size_s: float) -> None:
    inspection = inspected(tmp_path, *_rig({at_ns: size_s}))
    assert timing_codes(inspection) == [("TIM-212", "")]
    told = sentence(inspection, "TIM-212", "").removeprefix("The recorder's clock jumped by ")
    assert "jump with it" not in told
    assert float(told.partition(" s at ")[0]) == pytest.approx(size_s, abs=0.005)
    assert "time zone" not in " ".join(one.message for one in inspection.findings)
    offsets = {clock.topic: clock.offset_ns or 0 for clock in inspection.clocks.topics}
    assert all(0 < offset_ns < 200 * MS for offset_ns in offsets.values())


def test_two_jumps_are_two(tmp_path: Path) -> None:
    inspection = inspected(tmp_path, *_rig({1_500 * MS: 3600.0, 2_900 * MS: 7200.0}))
    assert timing_codes(inspection) == [("TIM-212", ""), ("TIM-212", "")]


@pytest.mark.parametrize("size_s", JUMPS_S)
@pytest.mark.parametrize("at_ns", [1_700 * MS, 2_620 * MS])
@pytest.mark.parametrize("has_imu", [True, False])
def test_what_the_recorders_host_stamps_jumps_with_it_and_is_named(
    tmp_path: Path, at_ns: int, size_s: float, has_imu: bool
) -> None:
    """The LiDAR and the IMU keep time, the poses are stamped by the clock that jumps: they meet no sweep after it."""
    lidar, imu, _camera = _rig({at_ns: size_s})
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


@pytest.mark.parametrize("size_s", JUMPS_S)
def test_a_sensor_whose_own_clock_jumps_is_not_the_recorder(tmp_path: Path, size_s: float) -> None:
    ahead = np.where(np.arange(400) >= 250, round(size_s * S), 0)
    inspection = inspected(tmp_path, *_rig({}, ahead))
    assert "TIM-212" not in [code for code, _topic in timing_codes(inspection)]


def test_a_recorder_that_was_held_up_and_caught_up_did_not_jump(tmp_path: Path) -> None:
    """For 1.6 s it took nothing, then all that had waited at once."""
    stop_ns, go_ns = SWEEPS[0] + 1 * S, SWEEPS[0] + 2_600 * MS
    held = {}
    for name, times_ns in (("lidar", SWEEPS), ("imu", READINGS), ("camera", SHOTS)):
        late_ns = times_ns + 10 * MS
        held[name] = np.where((late_ns > stop_ns) & (late_ns < go_ns), go_ns + (late_ns - stop_ns) // 1000, late_ns)
    groups = (
        clouds(SWEEPS, held["lidar"]),
        stream("/imu", IMU, READINGS, held["imu"]),
        stream("/camera/image", IMAGE, SHOTS, held["camera"]),
    )
    assert "TIM-212" not in [code for code, _topic in timing_codes(inspected(tmp_path, *groups))]


def test_a_recorder_that_is_hours_off_from_the_start_names_no_time_zone(tmp_path: Path) -> None:
    """The radar is 3 s apart from the others: that is no time zone, though the recorder's distance from it is one."""
    off = {-10 * S: 3603.0}
    radar = radar_lists("/radar", RADAR_NS + 3 * S, RADAR_NS)
    late = [Recorded(one.topic, one.type, time_ns, one.payload) for one, time_ns in
            zip(radar, _logged(RADAR_NS + 10 * MS, off).tolist(), strict=True)]  # fmt: skip
    inspection = inspected(tmp_path, *_rig(off), late)
    assert "by 3.0" in sentence(inspection, "TIM-202", "/radar")
    assert "time zone" not in " ".join(one.message for one in inspection.findings)
