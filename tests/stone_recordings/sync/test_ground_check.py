"""A mount entered wrongly is told with what to enter, is put right where that is asked for, and makes no labels."""

import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.labeler.local_run import LabelOptions, label
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.ground_plane import TOLERATED_RAD
from stone.sensors.height_drift import TOLERATED_M
from stone.sensors.sequence import Sequence, Sweep, SweepSource
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.sync.ground_check import early_ground
from stone_recordings.sync.ground_looks import AHEAD, seen_ahead, seen_along, seen_around
from stone_recordings.sync.height_check import height_followed
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from testing.refusals import refused_as
from testing.worlds.faults.drive import SoundDrive, faulty
from testing.worlds.faults.edits import METRES_A_DEGREE
from testing.worlds.faults.fault import RecordingFault
from testing.worlds.faults.other_edits import rolled

DRIVE = SimulateOptions(seconds=6.0, seed=3, channels=32, columns=360, cameras=False, compression="none")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration]:
    bag = tmp_path_factory.mktemp("drive") / "drive.mcap"
    simulate(bag, DRIVE)
    return bag, read_calibration(calibration_path(bag))[0]


@dataclass
class CountedSweeps:
    """Sweeps of another source, with which were asked for, by which threads."""

    source: SweepSource
    rows: list[int] = field(default_factory=list)
    threads: set[int] = field(default_factory=set)

    def sweep(self, index: int) -> Sweep:
        self.rows.append(index)
        self.threads.add(threading.get_ident())
        return self.source.sweep(index)


def mounted(rig: Calibration, higher_m: float = 0.0, pitch_deg: float = 0.0) -> Calibration:
    """The calibration with its LiDAR entered so much too high, and pitched."""
    half = np.deg2rad(pitch_deg) / 2
    wrong = SE3.from_parts(np.array([np.cos(half), 0, np.sin(half), 0]), np.array([0.0, 0.0, higher_m]))
    return replace(rig, ego_from_lidar=wrong @ rig.ego_from_lidar)


def codes(sequence) -> list[str]:
    return [finding.code for finding in sequence.findings if finding.code.startswith("CAL-43")]


@pytest.fixture(scope="module")
def right(drive: tuple[Path, Calibration]) -> tuple[Sequence, SweepSource]:
    return synchronise(*drive, SynchroniseOptions(), "right")


def test_a_right_mount_is_not_spoken_of(right: tuple[Sequence, SweepSource]) -> None:
    sequence, _ = right
    assert sequence.ground is not None
    assert abs(sequence.ground.height_m) < 0.05
    assert codes(sequence) == []
    assert read_sequence(sequence_bytes(sequence)).ground == sequence.ground


def test_sweeps_are_read_a_few_ahead_by_one_thread_and_given_in_order(right: tuple[Sequence, SweepSource]) -> None:
    sequence, sweeps = right
    told = CountedSweeps(sweeps)
    seen, rows = list[np.ndarray](), [0, 7, 3, 12, 5, 30, 31]
    for points in seen_ahead(sequence, told, rows):
        seen.append(points)
        assert len(told.rows) <= len(seen) + AHEAD
    assert told.rows == rows
    assert len(told.threads - {threading.get_ident()}) == len(told.threads) == 1
    for points, row in zip(seen, rows, strict=True):
        np.testing.assert_array_equal(points, seen_around(sequence, sweeps, row))


@pytest.mark.whole
@pytest.mark.parametrize(("higher_m", "pitch_deg"), [(0.1, 0), (-0.5, 0), (0, 3)])
def test_a_wrong_mount_is_measured_against_the_right_one_and_put_right(drive, right, higher_m, pitch_deg):
    (bag, rig), right = drive, right[0].ground
    sequence, _ = synchronise(bag, mounted(rig, higher_m, pitch_deg), SynchroniseOptions(), "mounted")
    assert right is not None
    assert sequence.ground is not None
    assert sequence.ground.height_m - right.height_m == pytest.approx(higher_m, abs=0.02)
    assert np.rad2deg(sequence.ground.slope_x - right.slope_x) == pytest.approx(-pitch_deg, abs=0.5)
    assert codes(sequence) == ["CAL-433"]
    auto, _ = synchronise(bag, mounted(rig, higher_m, pitch_deg), SynchroniseOptions(ground="auto"), "mounted")
    assert codes(auto) == ["CAL-434"]
    off = auto.calibration.ego_from_lidar @ rig.ego_from_lidar.inverse()
    # What stays is what terrain makes of the right mount, too.
    assert off.translation_m[2] == pytest.approx(-right.height_m, abs=0.03)
    assert abs(off.wxyz[2]) < np.deg2rad(1.0)


@pytest.mark.parametrize("higher_m", [0.0, -0.5])
def test_a_few_sweeps_as_they_were_recorded_show_the_ground_that_the_run_shows(
    drive: tuple[Path, Calibration], right: tuple[Sequence, SweepSource], higher_m: float
) -> None:
    bag, rig = drive
    measured = right[0].ground
    with open_bag(bag) as opened:
        early = early_ground(opened, "/lidar_points", mounted(rig, higher_m))
    assert measured is not None
    assert early is not None
    assert early.height_m - measured.height_m == pytest.approx(higher_m, abs=0.03)


def ends(bag: Path, entered: list[Calibration]) -> list[SE3]:
    """Where ground auto leaves the LiDAR, for each calibration that may be entered."""
    options = SynchroniseOptions(ground="auto")
    return [synchronise(bag, rig, options, "auto")[0].calibration.ego_from_lidar for rig in entered]


def off_rad(mount: SE3, other: SE3) -> float:
    return float(2 * np.linalg.norm((mount @ other.inverse()).wxyz[1:]))


@pytest.mark.whole
def test_ground_auto_ends_at_one_height_whatever_was_entered_and_leaves_the_tilt(drive):
    """Catches alone rounds that end before the height has settled, and a tilt that is taken along."""
    bag, rig = drive
    mounts = ends(bag, [rig, *(mounted(rig, high_m) for high_m in (-0.5, 0.5))])
    for mount in mounts:
        assert abs(mount.translation_m[2] - mounts[0].translation_m[2]) < 0.002
        assert off_rad(mount, rig.ego_from_lidar) < 1e-9


@pytest.mark.whole
def test_ground_auto_ends_at_one_tilt_whatever_was_entered_beyond_terrain(drive: tuple[Path, Calibration]) -> None:
    """Catches alone rounds that end before the tilt has settled. To 2 mm and 0.02°: a hundredth of a label voxel, and
    at 10 m a sixtieth."""
    bag, rig = drive
    mounts = ends(bag, [rolled(by_deg, axis)(rig) for by_deg, axis in ((-3.0, 0), (3.0, 1))])
    for mount in mounts:
        assert abs(mount.translation_m[2] - mounts[0].translation_m[2]) < 0.002
        assert off_rad(mount, mounts[0]) < np.deg2rad(0.02)
        assert off_rad(mount, rig.ego_from_lidar) < TOLERATED_RAD


@pytest.mark.whole
def test_no_labels_are_made_of_a_footprint_that_floats(drive: tuple[Path, Calibration], tmp_path: Path) -> None:
    bag, rig = drive
    sequence, sweeps = synchronise(bag, mounted(rig, -0.23), SynchroniseOptions(), "floats")
    with refused_as("footprint_off_ground"):
        label(sequence, sweeps, tmp_path / "labels")
    assert not (tmp_path / "labels").exists()


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


def climbing(long_drive: SoundDrive, rate: float, folder: Path) -> Path:
    return faulty(long_drive, RecordingFault("climbs", "pose", Climbing(rate)), folder / f"climbing-{rate}.mcap")


@pytest.fixture(scope="module")
def long_drive(tmp_path_factory: pytest.TempPathFactory) -> SoundDrive:
    return driven(tmp_path_factory.mktemp("drive"), SHORT)


def opened(long_drive: SoundDrive, bag: Path | None = None, rig=None) -> tuple[Sequence, SweepSource]:
    return synchronise(bag or long_drive.bag, rig or long_drive.rig(), SynchroniseOptions(), "run")


def drift_codes(sequence: Sequence) -> list[str]:
    return [finding.code for finding in sequence.findings if finding.code in {"SYN-514", "SYN-515"}]


def raised(sequence: Sequence, up_m) -> Sequence:
    """The sequence with this much added to z of its frames (N,), and its track left alone."""
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 6] += up_m
    return replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)), findings=())


def test_a_sound_drive_keeps_its_poses_bit_for_bit_and_without_ground_nothing_is_said(long_drive):
    sequence, sweeps = opened(long_drive)
    assert drift_codes(sequence) == []
    assert sequence.height_drift.links > 20
    assert sequence.height_drift.apart_m < TOLERATED_M / 2
    again = height_followed(sequence, sweeps, sequence.ground, seen_along(sequence, sweeps))
    assert again.frames is sequence.frames
    assert again.track is sequence.track
    assert read_sequence(sequence_bytes(sequence)).height_drift == sequence.height_drift
    rough = raised(sequence, 0.5 * np.sin(np.arange(len(sequence.frames))))
    found = height_followed(rough, sweeps, sequence.ground, seen_along(rough, sweeps))
    assert drift_codes(found) == ["SYN-515"]
    assert np.array_equal(found.frames.map_from_ego.wxyz_xyz, rough.frames.map_from_ego.wxyz_xyz)
    assert not found.height_drift.is_followed
    assert height_followed(sequence, sweeps, None, seen_along(sequence, sweeps)) is sequence


@pytest.mark.whole
def test_a_drive_whose_receiver_climbs_is_put_back_where_it_drove(long_drive, tmp_path):
    right, (sequence, _) = (opened(long_drive)[0], opened(long_drive, climbing(long_drive, 0.015, tmp_path)))
    assert drift_codes(sequence) == ["SYN-514"]
    assert sequence.height_drift.is_followed
    off = sequence.frames.map_from_ego.translation_m - right.frames.map_from_ego.translation_m
    assert np.abs(off[:, 2] - off[0, 2]).max() < 0.06
    assert sequence.height_drift.span_m == pytest.approx(0.3, abs=0.06)
    rest, as_before = (one.frames.map_from_ego.wxyz_xyz[:, :6] for one in (sequence, right))
    np.testing.assert_allclose(rest, as_before, atol=1e-5)  # a degree is a little longer higher up
    between = sequence.track.at(sequence.frames.stamps_ns).map_from_ego
    np.testing.assert_allclose(between.wxyz_xyz, sequence.frames.map_from_ego.wxyz_xyz, atol=2e-3)


@pytest.mark.whole
def test_a_wrong_mount_is_not_taken_for_drift(long_drive):
    """Its ground is tilted in the ego frame: CAL-433 from 1.5° on, and nothing below."""
    for pitch_deg, told in ((1.0, []), (3.0, ["CAL-433"])):
        sequence, _ = opened(long_drive, rig=mounted(long_drive.rig(), pitch_deg=pitch_deg))
        assert [f.code for f in sequence.findings if f.code.startswith("CAL-43")] == told
        assert drift_codes(sequence) == []


@pytest.mark.release
def test_of_200_m_that_climb_by_one_in_a_hundred_98_percent_of_the_way_are_t(tmp_path):
    """Catches alone: drift that is followed in the poses and not in the labels."""
    long_drive = driven(tmp_path, LONG)
    sequence, sweeps = opened(long_drive, climbing(long_drive, 0.01, tmp_path))
    report = label(sequence, sweeps, tmp_path / "labels", LabelOptions(workers=2)).as_record()
    assert report["height_drift"]["is_followed"]
    assert report["height_drift"]["driven_m"] == pytest.approx(200.0, abs=3.0)
    assert report["track"]["closed_ratio"] >= 0.98
    assert report["track"]["bare_ratio"] == 0.0
    assert "LAB-607" not in {finding["code"] for finding in report["findings"]}
