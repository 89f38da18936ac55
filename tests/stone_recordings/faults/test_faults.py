"""Each of the twelve ways in which the simulated rig goes wrong is found and named; the clean drive is clean.

Catches alone a fault of the rig that goes by another name when a whole recording has it.
"""

import re
from typing import get_args

import pytest

from simulator.faults import (
    DRIFT_RATIO,
    DRIFTING_TOPIC,
    DROPPING_CHANNEL,
    FIX_GAP_NS,
    IMU_LAG_NS,
    INVERTED_CHANNEL,
    LATE_CHANNEL,
    LATE_NS,
    STEP_BACK_NS,
    STEPPING_TOPIC,
    SWAPPED_CHANNELS,
)
from simulator.options import FaultName
from simulator.sensors.navigation import FIX_NS
from simulator.sensors.rig import cameras
from simulator.topics import BESTPOS_TOPIC, IMU_TOPIC, INSPVAX_TOPIC, LIDAR_TOPIC
from tests.stone_recordings.faults.conftest import Telling

pytestmark = pytest.mark.whole

TOPICS = {camera.channel: camera.topic for camera in cameras()}
Named = set[tuple[str, str]]
FOUND: dict[FaultName, Named] = {
    "gnss_jitter": {("TIM-201", INSPVAX_TOPIC), ("TIM-201", BESTPOS_TOPIC)},
    "clock_18s": {("TIM-202", INSPVAX_TOPIC), ("TIM-202", BESTPOS_TOPIC)},
    "clock_37s": {("TIM-202", LIDAR_TOPIC)},
    "camera_late_5ms": {("TIM-205", TOPICS[LATE_CHANNEL])},
    "camera_dropped": {("TIM-208", TOPICS[DROPPING_CHANNEL])},
    "radar_drift_50ppm": {("TIM-207", DRIFTING_TOPIC)},
    "imu_lag_12ms": {("TIM-209", IMU_TOPIC)},
    "rtk_gap": {("TIM-204", INSPVAX_TOPIC), ("TIM-204", BESTPOS_TOPIC)},
    "position_jump": {("GNS-302", INSPVAX_TOPIC)},
    "stamps_back": {("TIM-203", STEPPING_TOPIC)},
    "cameras_swapped": {("CAL-406", TOPICS[channel]) for channel in SWAPPED_CHANNELS},
    "extrinsic_inverted": {("CAL-404", INVERTED_CHANNEL)},
}


def test_nothing_is_found_on_the_clean_drive(told: Telling) -> None:
    clean = told()
    assert clean.findings == ()
    assert clean.sequence is not None
    assert clean.sequence.excluded == ()


def test_every_fault_of_the_simulator_is_proved_here() -> None:
    assert set(FOUND) == set(get_args(FaultName))


CONSEQUENCES: dict[FaultName, Named] = {
    # 37 s apart, not one sweep has a pose.
    "clock_37s": {("SYN-501", "")},
    "camera_dropped": {("TIM-204", TOPICS[DROPPING_CHANNEL]), ("SYN-504", TOPICS[DROPPING_CHANNEL])},
    "rtk_gap": {("SYN-501", ""), ("SYN-507", "")},
    "position_jump": {("GNS-301", INSPVAX_TOPIC), ("GNS-304", INSPVAX_TOPIC), ("SYN-501", ""), ("SYN-507", "")},
    "extrinsic_inverted": {("CAL-414", INVERTED_CHANNEL)},
}


@pytest.mark.parametrize("fault", list(FOUND))
def test_each_fault_is_found_and_named_and_accuses_nothing_that_is_sound(told: Telling, fault: FaultName) -> None:
    """By code and topic; whatever else is said is a consequence of this fault, and of what it touches."""
    codes = told(fault).codes
    assert codes >= FOUND[fault]
    assert codes <= FOUND[fault] | CONSEQUENCES.get(fault, set())


def number(pattern: str, sentence: str) -> float:
    match = re.search(pattern, sentence)
    assert match is not None, sentence
    return float(match.group(1))


def test_the_offsets_of_time_scales_are_recognised(told: Telling) -> None:
    assert "GPS − UTC" in told("clock_18s").sentence("TIM-202", INSPVAX_TOPIC)
    assert "TAI − UTC" in told("clock_37s").sentence("TIM-202", LIDAR_TOPIC)


def test_a_late_trigger_is_measured(told: Telling) -> None:
    sentence = told("camera_late_5ms").sentence("TIM-205", TOPICS[LATE_CHANNEL])
    assert number(r"(-?[\d.]+) ms", sentence) == pytest.approx(LATE_NS / 1e6, abs=1.0)


def test_the_drift_of_a_radar_is_measured(told: Telling) -> None:
    sentence = told("radar_drift_50ppm").sentence("TIM-207", DRIFTING_TOPIC)
    assert number(r"([-+][\d.]+) ppm", sentence) == pytest.approx(DRIFT_RATIO * 1e6, abs=15.0)


def test_the_lag_of_the_imu_is_recovered_within_2_ms(told: Telling) -> None:
    lag = told("imu_lag_12ms").inspection.clocks.imu_lag
    assert lag is not None
    assert abs(lag.lag_ns - IMU_LAG_NS) < 2_000_000
    without = told().inspection.clocks.imu_lag
    assert without is not None
    assert abs(without.lag_ns) < 2_000_000


def test_the_gap_of_the_receiver_is_measured_and_its_frames_left_out(told: Telling) -> None:
    gap = told("rtk_gap")
    assert number(r"longest of ([\d.]+) s", gap.sentence("TIM-204", INSPVAX_TOPIC)) == pytest.approx(FIX_GAP_NS / 1e9)
    assert gap.sequence is not None
    # A sweep lasts 0.1 s, so those of 0.5 s touch a gap of 0.4 s.
    assert [frame.code for frame in gap.sequence.excluded] == ["pose_gap"] * 5


def test_a_step_back_is_measured(told: Telling) -> None:
    sentence = told("stamps_back").sentence("TIM-203", STEPPING_TOPIC)
    assert number(r"worst by ([\d.]+) s", sentence) == pytest.approx((STEP_BACK_NS - FIX_NS) / 1e9)


def test_faults_are_told_apart_when_they_come_together(told: Telling) -> None:
    together: tuple[FaultName, ...] = ("clock_18s", "camera_late_5ms", "rtk_gap", "stamps_back", "extrinsic_inverted")
    assert told(*together).codes >= set().union(*(FOUND[fault] for fault in together))
