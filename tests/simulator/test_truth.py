"""The truth against closed forms: a tilted plane, a cylinder, a known drive."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.scenery.drivability import drivability
from simulator.scenery.objects import OBSTACLE
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.truth import (
    DRIVABLE,
    NOT_DRIVABLE,
    NOT_JUDGED,
    SimulationTruth,
    TruthFolderError,
    TruthGround,
    TruthStampError,
    read_truth,
    truth_over,
)
from stone.geometry.se3 import SE3
from tests.simulator.conftest import Recording

RESOLUTION_M = 0.2


def plane(tilt_deg: float, rows: int = 60, columns: int = 80) -> NDArray[np.float64]:
    x = np.arange(columns) * RESOLUTION_M
    return np.tile(np.tan(np.deg2rad(tilt_deg)) * x, (rows, 1))


def truth_on(height_m: NDArray[np.float64], obstacles: list[tuple[float, ...]] | None = None) -> SimulationTruth:
    drive = DriveTrajectory(1000, SE3.identity((4,)))
    rows = np.array(obstacles or [], OBSTACLE)
    return truth_over(TruthGround(height_m, rows, (0.0, 0.0), RESOLUTION_M), drive, np.array([1000]))


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 21.0, 35.0])
def test_a_tilted_plane_has_exactly_its_slope(tilt_deg: float) -> None:
    inner = (slice(15, -15), slice(15, -15))
    slope = drivability(plane(tilt_deg), RESOLUTION_M).slope_rad[inner]
    np.testing.assert_allclose(np.rad2deg(slope), tilt_deg, atol=1e-3)


@pytest.mark.parametrize(("tilt_deg", "expected"), [(0.0, DRIVABLE), (20.0, DRIVABLE), (24.0, NOT_DRIVABLE)])
def test_a_plane_is_drivable_up_to_22_degrees(tilt_deg: float, expected: int) -> None:
    truth = truth_on(plane(tilt_deg))
    xy = np.array([[8.0, 6.0], [7.3, 5.1]])
    points = np.concatenate([xy, truth.elevation_m(xy)[:, None]], axis=1)
    assert truth.judge(points).tolist() == [expected, expected]
    np.testing.assert_allclose(np.rad2deg(truth.slope_rad(xy)), tilt_deg, atol=1e-3)


def test_a_step_and_broken_ground_are_not_drivable() -> None:
    step = plane(0.0)
    step[:, 40:] += 0.6
    field = drivability(step, RESOLUTION_M).is_drivable
    assert not field[30, 39:41].any()
    assert field[30, 20]
    rubble = plane(0.0) + 0.1 * np.random.default_rng(0).standard_normal((60, 80))
    assert drivability(rubble, RESOLUTION_M).is_drivable.mean() < 0.05


def test_only_the_surface_is_judged() -> None:
    truth = truth_on(plane(0.0))
    column = np.array([[8.0, 6.0, z] for z in (-1.0, -0.2, 0.0, 0.2, 0.4, 3.0)])
    assert truth.judge(column).tolist() == [NOT_JUDGED, DRIVABLE, DRIVABLE, DRIVABLE, NOT_JUDGED, NOT_JUDGED]


def test_an_obstacle_blocks_its_disc_up_to_its_top() -> None:
    truth = truth_on(plane(0.0), [(8.0, 6.0, 0.5, -0.5, 1.0, 2)])
    points = np.array([[8.0, 6.0, 0.0], [8.4, 6.0, 0.9], [8.0, 6.0, 1.5], [9.0, 6.0, 0.0]])
    assert truth.judge(points).tolist() == [NOT_DRIVABLE, NOT_DRIVABLE, NOT_JUDGED, DRIVABLE]


def test_nothing_is_judged_outside_the_world() -> None:
    truth = truth_on(plane(0.0))
    assert truth.judge(np.array([[-1.0, 6.0, 0.0], [8.0, 400.0, 0.0]])).tolist() == [NOT_JUDGED, NOT_JUDGED]


def test_a_stamp_outside_the_drive_is_refused() -> None:
    with pytest.raises(TruthStampError, match="another recording's truth"):
        truth_on(plane(0.0)).map_from_ego(999)


def test_poses_stand_on_the_ground(recording: Recording) -> None:
    poses = recording.truth.trajectory.map_from_ego
    above = poses.translation_m[:, 2] - recording.truth.elevation_m(poses.translation_m[:, :2])
    assert np.abs(above).max() < 0.10
    up = poses.rotation()[:, 2, 2]
    tilt = np.arccos(up) - recording.truth.slope_rad(poses.translation_m[:, :2])
    assert np.rad2deg(np.abs(tilt)).max() < 8.0


def test_the_drive_keeps_to_drivable_ground(recording: Recording) -> None:
    places = recording.truth.trajectory.map_from_ego.translation_m
    assert np.all(recording.truth.judge(places) == DRIVABLE)


def test_the_drive_has_the_robots_speed(recording: Recording) -> None:
    steps = np.diff(recording.truth.trajectory.map_from_ego.translation_m, axis=0)
    speed = np.linalg.norm(steps, axis=1) / (POSE_NS * 1e-9)
    assert 1.2 < speed.min() < speed.max() < 2.0


def test_a_folder_without_truth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TruthFolderError, match="stone simulate --truth"):
        read_truth(tmp_path)


def test_poses_that_are_not_evenly_spaced_are_refused(recording: Recording, tmp_path: Path) -> None:
    source = recording.path.parent / "truth"
    for name in ("heightfield.npz", "world.json"):
        (tmp_path / name).write_bytes((source / name).read_bytes())
    poses = dict(np.load(source / "poses.npz"))
    np.savez(tmp_path / "poses.npz", **(poses | {"stamps_ns": poses["stamps_ns"] * 2}))
    with pytest.raises(TruthFolderError, match="ns apart"):
        read_truth(tmp_path)


def test_the_truth_names_its_options(recording: Recording) -> None:
    record = json.loads((recording.path.parent / "truth" / "world.json").read_text())
    assert record["options"]["seed"] == 3
