"""A tilted LiDAR, tilted poses, a pitched body, in recordings of an analytic world: which is refused, and that labels
are made after what the refusals recommend."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.outside.remedies import AS_ADVISED, GROUND_AUTO, fault_of, opened
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from stone.sensors.ground_refusals import ground_refusal
from stone.sensors.sequence import Sequence
from stone_recordings.poses.file_poses import PoseFile
from testing.outside.drive import OutsideDrive
from testing.outside.recording import EGO_FROM_INS_M, START_NS

pytestmark = pytest.mark.whole

DRIVE = OutsideDrive("forest", 32, seconds=12.0, columns=360)
BAND_M = 0.15
REFUSED = {
    "sound": "",
    "mount pitch 2°": "footprint_off_ground",
    "mount roll -2°": "footprint_off_ground",
    "INS tilted 2°": "poses_tilted",
    "body pitched 2°": "",
    f"mount pitch 2°, {GROUND_AUTO}": "",
    f"mount roll -2°, {GROUND_AUTO}": "",
    f"body pitched 2°, {GROUND_AUTO}": "",
    f"mount pitch 2°, {AS_ADVISED}": "",
    f"INS tilted 2°, {AS_ADVISED}": "",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("outside")


def refusal(sequence: Sequence) -> str:
    found = ground_refusal(sequence)
    return "" if found is None else found.code


@pytest.mark.parametrize("row", REFUSED)
def test_a_tilt_is_refused_by_its_cause_and_what_is_recommended_is_not(folder: Path, tmp_path: Path, row: str) -> None:
    bag, calibration, _ = DRIVE.record(folder, fault_of(row), tmp_path)
    sequence, _ = opened(row, bag, calibration)
    assert refusal(sequence) == REFUSED[row]
    is_told = {one.code for one in sequence.findings if "labelling refuses" in one.message}
    assert is_told == {"footprint_off_ground": {"CAL-433"}, "poses_tilted": {"SYN-518"}, "": set()}[REFUSED[row]]


def test_ground_auto_leaves_the_tilt_of_a_pitched_body_whose_poses_are_of_its_own_frame(folder: Path, tmp_path: Path):
    bag, calibration, data = DRIVE.record(folder, "body pitched 2°", tmp_path)
    ego = data.world_from_ins.copy()
    ego[:, :3, 3] -= ego[:, :3, :3] @ EGO_FROM_INS_M
    table = np.column_stack([ego[:, :3, 3], Rotation.from_matrix(ego[:, :3, :3]).as_quat()])
    stamps = [f"{(START_NS + round(one * 1e9)) / 1e9:.6f}" for one in data.pose_s.tolist()]
    lines = [f"{stamp} {' '.join(f'{n:.9f}' for n in row)}" for stamp, row in zip(stamps, table.tolist(), strict=True)]
    (tmp_path / "poses.tum").write_text("\n".join(lines) + "\n")
    options = SynchroniseOptions(poses=PoseFile(tmp_path / "poses.tum"))
    given, _ = open_sequence(bag, calibration, "outside", options)
    auto, _ = open_sequence(bag, calibration, "outside", replace(options, ground="auto"))
    assert given.ground is not None
    assert given.ground.is_body_pitched
    assert (refusal(given), refusal(auto)) == ("", "")
    turned = auto.calibration.ego_from_lidar @ given.calibration.ego_from_lidar.inverse()
    assert np.linalg.norm(turned.wxyz[1:]) < 1e-9
