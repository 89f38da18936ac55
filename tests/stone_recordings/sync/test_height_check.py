"""Poses that climb against the ground are followed in z and in nothing else; others stay as they were, bit for bit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.labeler.local_run import LabelOptions, label
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.geometry.se3 import SE3
from stone.sensors.height_drift import TOLERATED_M
from stone.sensors.sequence import Sequence, SweepSource
from stone_recordings.sync.height_check import height_followed
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from testing.worlds.faults.drive import SoundDrive, faulty
from testing.worlds.faults.edits import METRES_A_DEGREE
from testing.worlds.faults.fault import RecordingFault
from tests.stone_recordings.sync.test_ground_check import mounted

INSPVAX = "/novatel/oem7/inspvax"
SHORT = SimulateOptions(seconds=14.0, seed=3, channels=32, columns=360, cameras=False, compression="none")
LONG = replace(SHORT, seconds=134.0, seed=4)


class Climbing:
    """An edit: the height of every pose grows by a share of the way driven."""

    def __init__(self, rate: float) -> None:
        self._rate, self._last, self._up_m = rate, None, 0.0

    def __call__(self, message: Any) -> Any:
        here = np.array([message.latitude, message.longitude * np.cos(np.deg2rad(message.latitude))]) * METRES_A_DEGREE
        if self._last is not None:
            self._up_m += self._rate * float(np.linalg.norm(here - self._last))
        self._last = here
        message.height += self._up_m
        return message


def driven(folder: Path, options: SimulateOptions) -> SoundDrive:
    bag = folder / "drive.mcap"
    simulate(bag, options)
    topic = {"pose": INSPVAX}
    return SoundDrive("drive", bag, calibration_path(bag), {INSPVAX: "novatel_oem7_msgs/msg/INSPVAX"}, topic)


def climbing(drive: SoundDrive, rate: float, folder: Path) -> Path:
    return faulty(drive, RecordingFault("climbs", "pose", Climbing(rate)), folder / f"climbing-{rate}.mcap")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> SoundDrive:
    return driven(tmp_path_factory.mktemp("drive"), SHORT)


def opened(drive: SoundDrive, bag: Path | None = None, rig=None) -> tuple[Sequence, SweepSource]:
    return synchronise(bag or drive.bag, rig or drive.rig(), SynchroniseOptions(), "run")


def codes(sequence: Sequence) -> list[str]:
    return [finding.code for finding in sequence.findings if finding.code in {"SYN-514", "SYN-515"}]


def raised(sequence: Sequence, up_m) -> Sequence:
    """The sequence with this much added to z of its frames (N,), and its track left alone."""
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 6] += up_m
    return replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)), findings=())


def test_a_sound_drive_keeps_its_poses_bit_for_bit(drive):
    sequence, sweeps = opened(drive)
    assert codes(sequence) == []
    assert sequence.height_drift.links > 20
    assert sequence.height_drift.apart_m < TOLERATED_M / 2
    again = height_followed(sequence, sweeps, sequence.ground)
    assert again.frames is sequence.frames
    assert again.track is sequence.track
    assert read_sequence(sequence_bytes(sequence)).height_drift == sequence.height_drift


def test_a_drive_whose_receiver_climbs_is_put_back_where_it_drove(drive, tmp_path):
    right, (sequence, _) = opened(drive)[0], opened(drive, climbing(drive, 0.015, tmp_path))
    assert codes(sequence) == ["SYN-514"]
    assert sequence.height_drift.is_followed
    off = sequence.frames.map_from_ego.translation_m - right.frames.map_from_ego.translation_m
    assert np.abs(off[:, 2] - off[0, 2]).max() < 0.06
    assert sequence.height_drift.span_m == pytest.approx(0.3, abs=0.06)
    rest, as_before = (one.frames.map_from_ego.wxyz_xyz[:, :6] for one in (sequence, right))
    np.testing.assert_allclose(rest, as_before, atol=1e-5)  # a degree is a little longer higher up
    between = sequence.track.at(sequence.frames.stamps_ns).map_from_ego
    np.testing.assert_allclose(between.wxyz_xyz, sequence.frames.map_from_ego.wxyz_xyz, atol=2e-3)


def test_heights_that_jump_about_are_told_and_left_alone(drive):
    sequence, sweeps = opened(drive)
    rough = raised(sequence, 0.5 * np.sin(np.arange(len(sequence.frames))))
    found = height_followed(rough, sweeps, sequence.ground)
    assert codes(found) == ["SYN-515"]
    assert np.array_equal(found.frames.map_from_ego.wxyz_xyz, rough.frames.map_from_ego.wxyz_xyz)
    assert not found.height_drift.is_followed


def test_a_wrong_mount_is_not_taken_for_drift(drive):
    """Its ground is tilted in the ego frame: CAL-433 from 1.5° on, and nothing below."""
    for pitch_deg, told in ((1.0, []), (3.0, ["CAL-433"])):
        sequence, _ = opened(drive, rig=mounted(drive.rig(), pitch_deg=pitch_deg))
        assert [f.code for f in sequence.findings if f.code.startswith("CAL-43")] == told
        assert codes(sequence) == []


def test_where_the_ground_was_not_measured_nothing_is_said_of_drift(drive):
    sequence, sweeps = opened(drive)
    assert height_followed(sequence, sweeps, None) is sequence


@pytest.mark.whole
def test_of_200_m_that_climb_by_one_in_a_hundred_98_percent_of_the_way_are_t(tmp_path):
    """Catches alone: drift that is followed in the poses and not in the labels."""
    drive = driven(tmp_path, LONG)
    sequence, sweeps = opened(drive, climbing(drive, 0.01, tmp_path))
    report = label(sequence, sweeps, tmp_path / "labels", LabelOptions(workers=2)).as_record()
    assert report["height_drift"]["is_followed"]
    assert report["height_drift"]["driven_m"] == pytest.approx(200.0, abs=3.0)
    assert report["track"]["closed_ratio"] >= 0.98
    assert report["track"]["bare_ratio"] == 0.0
    assert "LAB-607" not in {finding["code"] for finding in report["findings"]}
