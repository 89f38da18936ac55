"""Each of the twelve ways in which the simulated rig goes wrong is found and named; the clean drive is clean.

Catches alone a fault of the rig that goes by another name when a whole recording has it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import get_args

import pytest

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from simulator.faults import (
    DRIFTING_TOPIC,
    DROPPING_CHANNEL,
    FIX_GAP_NS,
    IMU_LAG_NS,
    INVERTED_CHANNEL,
    LATE_CHANNEL,
    STEPPING_TOPIC,
    SWAPPED_CHANNELS,
)
from simulator.options import BESTPOS_TOPIC, IMU_TOPIC, INSPVAX_TOPIC, LIDAR_TOPIC, FaultName, SimulateOptions
from simulator.pipeline import calibration_path, simulate
from simulator.sensors.rig import cameras
from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.sequence import Sequence
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.report.inspection import Inspection, inspect

# A host whose stamps are the receiver's: the default one is late by up to 20 ms, which is a finding of its own.
CLEAN = SimulateOptions(
    seconds=6.0,
    seed=5,
    channels=16,
    columns=180,
    camera_width_px=64,
    compression="none",
    world_width_m=30.0,
    host_delay_max_ns=0,
    transport_jitter_ns=300_000,
)
# Pictures are most of the work, so only the clean drive and these have any.
OF_CAMERAS: set[FaultName] = {"camera_late_5ms", "camera_dropped", "cameras_swapped", "extrinsic_inverted"}


@dataclass(frozen=True, eq=False)
class Told:
    """What inspection, calibration and synchronisation said of one drive; `sequence` is None where it was refused."""

    inspection: Inspection
    sequence: Sequence | None
    findings: tuple[Finding, ...]

    @property
    def codes(self) -> set[tuple[str, str]]:
        """Code and topic (or channel) of each finding."""
        return {(finding.code, finding.topic) for finding in self.findings}

    def sentence(self, code: str, topic: str) -> str:
        return next(found.message for found in self.findings if (found.code, found.topic) == (code, topic))


Telling = Callable[..., Told]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Telling:
    """`told("rtk_gap", ...)`: the drive with these faults, looked at once a session."""

    @cache
    def tell(*faults: FaultName) -> Told:
        bag = tmp_path_factory.mktemp("drive") / "run.mcap"
        simulate(bag, replace(CLEAN, faults=faults, cameras=not faults or bool(OF_CAMERAS & set(faults))))
        return _told(bag)

    return tell


def _told(bag: Path) -> Told:
    inspection = inspect(bag)
    _calibration, doubts = read_calibration(calibration_path(bag))
    findings = inspection.findings + tuple(doubts)
    try:
        sequence, _sweeps = open_sequence(bag, calibration_path(bag), "run", SynchroniseOptions())
    except StoneError as refusal:
        return Told(inspection, None, (*findings, Finding(refusal.code, "error", "", str(refusal))))
    return Told(inspection, sequence, findings + sequence.findings)


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


CONSEQUENCES: dict[FaultName, Named] = {
    # 37 s apart, not one sweep has a pose.
    "clock_37s": {("SYN-501", "")},
    "camera_dropped": {("TIM-204", TOPICS[DROPPING_CHANNEL]), ("SYN-504", TOPICS[DROPPING_CHANNEL])},
    "rtk_gap": {("SYN-501", ""), ("SYN-507", "")},
    "position_jump": {("GNS-301", INSPVAX_TOPIC), ("GNS-304", INSPVAX_TOPIC), ("SYN-501", ""), ("SYN-507", "")},
    "extrinsic_inverted": {("CAL-414", INVERTED_CHANNEL)},
}


# Those of one drive touch other sensors, or are of another kind.
DRIVES: tuple[tuple[FaultName, ...], ...] = (
    ("camera_late_5ms", "imu_lag_12ms", "radar_drift_50ppm"), ("camera_dropped", "gnss_jitter"),
    ("cameras_swapped", "stamps_back"), ("extrinsic_inverted", "rtk_gap"), ("clock_18s",), ("clock_37s",),
    ("position_jump",),
)  # fmt: skip


@pytest.mark.parametrize("faults", DRIVES, ids="-".join)
def test_each_fault_is_found_and_named_and_accuses_nothing_that_is_sound(
    told: Telling, faults: tuple[FaultName, ...]
) -> None:
    """By code and topic; whatever else is said is a consequence of these faults, and of what they touch."""
    codes = told(*faults).codes
    found: Named = set().union(*(FOUND[fault] for fault in faults))
    assert codes >= found
    assert codes <= found.union(*(CONSEQUENCES.get(fault, set()) for fault in faults))


def test_every_fault_is_in_one_drive() -> None:
    assert sorted(fault for faults in DRIVES for fault in faults) == sorted(get_args(FaultName))


def of(told: Telling, fault: FaultName) -> Told:
    return told(*next(faults for faults in DRIVES if fault in faults))


def test_the_lag_of_the_imu_is_recovered_within_2_ms(told: Telling) -> None:
    lag = of(told, "imu_lag_12ms").inspection.clocks.imu_lag
    assert lag is not None
    assert abs(lag.lag_ns - IMU_LAG_NS) < 2_000_000
    without = told().inspection.clocks.imu_lag
    assert without is not None
    assert abs(without.lag_ns) < 2_000_000


def test_the_gap_of_the_receiver_is_measured_and_its_frames_left_out(told: Telling) -> None:
    gap = of(told, "rtk_gap")
    assert f"longest of {FIX_GAP_NS / 1e9:.3f} s" in gap.sentence("TIM-204", INSPVAX_TOPIC)
    assert gap.sequence is not None
    # A sweep lasts 0.1 s, so those of 0.5 s touch a gap of 0.4 s.
    assert [frame.code for frame in gap.sequence.excluded] == ["pose_gap"] * 5
