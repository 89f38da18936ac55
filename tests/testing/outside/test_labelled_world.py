"""A few seconds of an analytic world, recorded, opened and labelled. Catches alone: a recording of the outside worlds
that is read otherwise than it was driven, and labels of it that are wrong in every profile."""

from pathlib import Path

import numpy as np
import pytest

from services.ingest.sequence import open_sequence
from services.labeler.local_run import LabelOptions, label
from stone_base.label_grid import PAPER
from testing.outside.drive import OutsideDrive
from testing.outside.recording import LEAD_S
from testing.outside.track import LENGTH_M, WIDTH_M
from testing.outside.verdict import T, judge_labels

pytestmark = pytest.mark.release
DRIVE = OutsideDrive("forest", 16, seconds=5.0, columns=600)
WAY_S = np.linspace(-LEAD_S, DRIVE.seconds + LEAD_S, 200)  # the receiver's: the footprint follows all of its poses
HALF_DIAGONALS_M = 0.35  # of a voxel of the grid, and of the map's around it


def test_a_drive_is_read_as_driven_and_its_trunks_are_no_ground(tmp_path: Path) -> None:
    bag, calibration, data = DRIVE.record(tmp_path, "sound")
    sequence, sweeps = open_sequence(bag, calibration, "outside")
    driven, found = DRIVE.world.track.poses(np.arange(50) * 0.1), sequence.frames.map_from_ego.as_matrix()
    moved, expected = (np.linalg.inv(poses[0]) @ poses for poses in (found, driven))
    np.testing.assert_allclose(moved[:, :3, 3], expected[:, :3, 3], atol=0.12)
    np.testing.assert_allclose(moved[:, :3, :3], expected[:, :3, :3], atol=0.02)
    label(sequence, sweeps, tmp_path / "labels", LabelOptions())
    figures = judge_labels(tmp_path / "labels", DRIVE.truth, data.ego_from_lidar).figures()
    assert (figures["missed trunk"], figures["t_wrong"]) == (0.0, 0.0)
    assert (figures["danger trunk"] or 0.0) < 0.05
    assert (figures["iou"] or 0.0) > 0.5
    beyond = [
        beyond_footprint(tmp_path / "labels", token, driven, row) for row, token in enumerate(sequence.frames.tokens)
    ]
    assert max(beyond[::10]) <= 0.0


def beyond_footprint(labels: Path, token: str, driven: np.ndarray, row: int) -> float:
    """Return how far the farthest T voxel of a frame lies beyond the footprint of every pose, metres."""
    with np.load(next(labels.glob(f"gts/*/{token}/labels.npz"))) as archive:
        index = np.argwhere(archive["semantics"] == T)
    points = ((index + 0.5) * 0.2 + PAPER.min_m) @ driven[row, :3, :3].T + driven[row, :3, 3]
    half = np.array([LENGTH_M, WIDTH_M]) / 2 + HALF_DIAGONALS_M
    nearest = np.full(len(points), np.inf)
    for pose in np.linalg.inv(DRIVE.world.track.poses(WAY_S)):
        local = points @ pose[:3, :3].T + pose[:3, 3]
        nearest = np.minimum(nearest, (np.abs(local[:, :2]) - half).max(axis=1))
    return float(nearest.max())
