"""Faults made of a real drive: labels stay as good as the clean ones, or the run says why there are none.

Catches alone what holds in the simulator and not on sparse real sweeps: T where nobody drove, two halves of a track in
one doubled map, a footprint that floats.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.labeler.errors import FootprintOffGroundError
from services.labeler.local_run import LabelOptions, label
from services.labeler.report import LabelReport
from stone.geometry.se3 import SE3
from stone.labels.grid import GRID_MIN_M
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Calibration
from stone.sensors.ego_path import maps_of_frames
from stone.sensors.sequence import Sequence
from stone_recordings.calibrations.file import read_calibration
from testing.worlds.altered import Change, altered, odometry_pose

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[3]
RECORDING = Path("kitti0005_ros2_mcap") / "kitti0005_lidar_odom.mcap"
BEGIN_NS = 1_317_046_414_000_000_000
ODOMETRY = "/odom"
BEYOND_M = 0.15 + 0.35 + 0.25  # the band, a voxel's diagonal, half a step of the track


@pytest.fixture(scope="module")
def recording(field_data: Path) -> Path:
    return field_data / RECORDING


@pytest.fixture(scope="module")
def rig() -> Calibration:
    return read_calibration(ROOT / "examples" / "kitti0005.calibration.yaml")[0]


@pytest.fixture(scope="module")
def clean(recording: Path, rig: Calibration, tmp_path_factory: pytest.TempPathFactory) -> LabelReport:
    return labelled(recording, rig, tmp_path_factory.mktemp("clean") / "labels")


def labelled(bag: Path, rig: Calibration, folder: Path, **options: Any) -> LabelReport:
    sequence, sweeps = synchronise(bag, rig, SynchroniseOptions(**options), "real")
    return label(sequence, sweeps, folder, LabelOptions(workers=2))


def driven_off_track_m(folder: Path, sequence: Sequence) -> np.ndarray:
    """How far every T voxel of every tenth frame is from the nearest pose of the track."""
    assert sequence.track is not None
    found = []
    for index in range(0, len(sequence.frames), 10):
        grid = np.load(folder / "gts" / "real" / sequence.frames.tokens[index] / "labels.npz")["semantics"]
        driven = sequence.frames.map_from_ego[index] @ (np.argwhere(grid == 1) * VOXEL_M + GRID_MIN_M + VOXEL_M / 2)
        gaps_m = np.linalg.norm(driven[:, None] - sequence.track.map_from_ego.translation_m, axis=2)
        found.append(gaps_m.min(axis=1))
    return np.concatenate(found)


def codes(sequence: Sequence) -> set[str]:
    return {finding.code for finding in sequence.findings}


def after(seconds: float) -> int:
    return BEGIN_NS + round(seconds * 1e9)


def jumped(topic: str, log_ns: int, data: bytearray) -> bytes:
    if topic == ODOMETRY and log_ns >= after(7.0):
        odometry_pose(data)[:3] += [0.0, 30.0, 1.0]
    return data


def silent(topic: str, log_ns: int, data: bytearray) -> bytes | None:
    return None if topic == ODOMETRY and after(6.0) < log_ns < after(10.0) else data


def unknown(topic: str, log_ns: int, data: bytearray) -> bytes:
    if topic == ODOMETRY and log_ns // 100_000_000 % 40 == 0:
        odometry_pose(data)[3:] = [0.0, 0.0, 0.0, 0.0 if log_ns // 100_000_000 % 80 else np.nan]
    return data


def test_the_clean_drive_is_one_level_ground_and_nothing_is_doubted(clean: LabelReport) -> None:
    assert {finding.code for finding in clean.findings} == {"CAL-414", "TOP-102", "LAB-603"}
    assert clean.reference.voxels > 3000
    assert np.rad2deg(np.sqrt(clean.reference.covariance[1, 1])) < 2.0
    assert clean.sequence.ground is not None
    assert abs(clean.sequence.ground.height_m) < 0.02


@pytest.mark.parametrize(("change", "frames"), [(jumped, 154), (silent, 114)], ids=["a jump of 30 m", "4 s of silence"])
def test_over_a_break_nothing_is_driven_and_the_map_is_one(
    recording: Path, rig: Calibration, clean: LabelReport, tmp_path: Path, change: Change, frames: int
) -> None:
    bag = altered(recording, tmp_path / "broken.mcap", change)
    report = labelled(bag, rig, tmp_path / "labels")
    sequence = report.sequence
    assert len(sequence.frames) == frames
    assert "SYN-507" in codes(sequence)
    assert set(maps_of_frames(sequence).tolist()) == {0}
    corner_m = np.hypot(rig.footprint.length_m, rig.footprint.width_m) / 2
    assert driven_off_track_m(tmp_path / "labels", sequence).max() < corner_m + BEYOND_M
    assert report.reference.voxels == pytest.approx(clean.reference.voxels * frames / 154, rel=0.1)
    shares = [one.class_shares()["potentially_traversable"] for one in (report, clean)]
    assert shares[0] == pytest.approx(shares[1], abs=0.02)


def test_poses_that_are_none_cost_themselves_alone(recording: Path, rig: Calibration, tmp_path: Path) -> None:
    bag = altered(recording, tmp_path / "unknown.mcap", unknown)
    sequence, _ = synchronise(bag, rig, SynchroniseOptions(), "real")
    assert len(sequence.frames) >= 150
    assert "MSG-305" in codes(sequence)


def test_a_lidar_entered_too_low_makes_no_labels_unless_the_ground_corrects_it(
    recording: Path, rig: Calibration, clean: LabelReport, tmp_path: Path
) -> None:
    lower = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, -0.23]))
    wrong = replace(rig, ego_from_lidar=lower @ rig.ego_from_lidar)
    with pytest.raises(FootprintOffGroundError):
        labelled(recording, wrong, tmp_path / "none")
    report = labelled(recording, wrong, tmp_path / "labels", ground="auto")
    assert "CAL-434" in codes(report.sequence)
    assert report.reference.voxels == pytest.approx(clean.reference.voxels, rel=0.01)
    for name, share in clean.class_shares().items():
        assert report.class_shares()[name] == pytest.approx(share, abs=0.002)
