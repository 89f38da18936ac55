"""Drawn worlds: good for the labels' proof, and independent of how they are looked at."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.options import SimulateOptions
from simulator.scenery.movers import WALKER_HEIGHT_M, WALKER_RADIUS_M, cylinder_range
from simulator.scenery.objects import OBSTACLE, Surface
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.scenery.scene import RayScene, ground_mesh
from simulator.scenery.terrain import Terrain
from simulator.scenery.world import build_world, drivability
from simulator.sensors.navigation import take_inertia
from simulator.truth import DRIVABLE, NOT_DRIVABLE, NOT_JUDGED, SimulationTruth, TruthGround, read_truth, truth_over
from simulator.verdict import LabelVerdict, judge_semantics
from stone.geometry.se3 import SE3
from stone_base.label_grid import PAPER
from testing.refusals import refused_as
from tests.simulator.conftest import Recording


def test_rays_straight_down_meet_the_terrain_and_more_of_them_do_not_move_a_tree() -> None:
    options = SimulateOptions(seconds=0.2, seed=5, world_width_m=40.0)
    world = build_world(options)
    xy = world.trajectory.map_from_ego.translation_m[::20, :2]
    origins = np.concatenate([xy, np.full((len(xy), 1), 30.0)], axis=1).astype(np.float32)
    hits = RayScene(world).cast(origins, np.tile(np.float32([0, 0, -1]), (len(xy), 1)))
    is_ground = hits.surface == Surface.GROUND
    assert is_ground.any()
    np.testing.assert_allclose((30.0 - hits.range_m)[is_ground], world.terrain.elevation_m(xy)[is_ground], atol=0.03)
    few, many = build_world(options), build_world(replace(options, channels=128, columns=1800, cameras=False))
    np.testing.assert_array_equal(few.objects.triangles, many.objects.triangles)
    np.testing.assert_array_equal(few.trajectory.map_from_ego.wxyz_xyz, many.trajectory.map_from_ego.wxyz_xyz)


def test_the_ground_mesh_has_two_triangles_a_cell_and_the_walker_is_a_cylinder() -> None:
    terrain = Terrain(np.zeros((4, 5)), np.ones((4, 5), bool), np.zeros((4, 5)))
    vertices, faces = ground_mesh(terrain)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    assert len(faces) == 2 * 3 * 4
    assert np.all(normals[:, 2] > 0)
    foot = np.array([5.0, 0.0, 0.0])
    origins = np.tile(np.float32([0, 0, 1.0]), (4, 1))
    high = np.float32([5.0 - WALKER_RADIUS_M, 0, WALKER_HEIGHT_M])
    high /= np.linalg.norm(high)
    directions = np.stack([np.float32([1, 0, 0]), np.float32([-1, 0, 0]), np.float32([0, 1, 0]), high])
    reach = cylinder_range(foot, origins, directions)
    assert reach[0] == pytest.approx(5.0 - WALKER_RADIUS_M)
    assert np.isinf(reach[1:]).all()


def test_a_robot_feels_gravity_and_its_turns_alone() -> None:
    still = DriveTrajectory(0, SE3.identity((401,)))
    inertia = take_inertia(still, 400 * POSE_NS, np.random.default_rng(0))
    np.testing.assert_allclose(inertia.linear_acceleration_m_s2.mean(axis=0), [0, 0, 9.80665], atol=0.01)
    np.testing.assert_allclose(inertia.angular_velocity_rad_s.mean(axis=0), 0, atol=1e-3)
    rate = 0.4
    half = rate * np.arange(401) * POSE_NS * 1e-9 / 2
    wxyz = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)
    inertia = take_inertia(
        DriveTrajectory(0, SE3.from_parts(wxyz, np.zeros(3))), 400 * POSE_NS, np.random.default_rng(0)
    )
    np.testing.assert_allclose(inertia.angular_velocity_rad_s.mean(axis=0), [0, 0, rate], atol=1e-3)


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


def test_only_the_surface_inside_the_world_and_stamps_of_the_drive_are_judged() -> None:
    truth = truth_on(plane(0.0))
    column = np.array([[8.0, 6.0, z] for z in (-1.0, -0.2, 0.0, 0.2, 0.4, 3.0)])
    assert truth.judge(column).tolist() == [NOT_JUDGED, DRIVABLE, DRIVABLE, DRIVABLE, NOT_JUDGED, NOT_JUDGED]
    assert truth.judge(np.array([[-1.0, 6.0, 0.0], [8.0, 400.0, 0.0]])).tolist() == [NOT_JUDGED, NOT_JUDGED]
    with refused_as("stamp_outside_truth"):
        truth_on(plane(0.0)).map_from_ego(999)


def test_an_obstacle_blocks_its_disc_up_to_its_top() -> None:
    truth = truth_on(plane(0.0), [(8.0, 6.0, 0.5, -0.5, 1.0, 2)])
    points = np.array([[8.0, 6.0, 0.0], [8.4, 6.0, 0.9], [8.0, 6.0, 1.5], [9.0, 6.0, 0.0]])
    assert truth.judge(points).tolist() == [NOT_DRIVABLE, NOT_DRIVABLE, NOT_JUDGED, DRIVABLE]


def test_the_drive_stands_on_drivable_ground_at_the_robots_speed(recording: Recording) -> None:
    poses = recording.truth.trajectory.map_from_ego
    above = poses.translation_m[:, 2] - recording.truth.elevation_m(poses.translation_m[:, :2])
    assert np.abs(above).max() < 0.10
    up = poses.rotation()[:, 2, 2]
    tilt = np.arccos(up) - recording.truth.slope_rad(poses.translation_m[:, :2])
    assert np.rad2deg(np.abs(tilt)).max() < 8.0
    places = recording.truth.trajectory.map_from_ego.translation_m
    assert np.all(recording.truth.judge(places) == DRIVABLE)
    steps = np.diff(recording.truth.trajectory.map_from_ego.translation_m, axis=0)
    speed = np.linalg.norm(steps, axis=1) / (POSE_NS * 1e-9)
    assert 1.2 < speed.min() < speed.max() < 2.0


def test_a_folder_without_truth_or_with_uneven_poses_is_refused(tmp_path: Path, recording: Recording) -> None:
    with refused_as("not_a_truth_folder"):
        read_truth(tmp_path)
    source = recording.path.parent / "truth"
    for name in ("heightfield.npz", "world.json"):
        (tmp_path / name).write_bytes((source / name).read_bytes())
    poses = dict(np.load(source / "poses.npz"))
    np.savez(tmp_path / "poses.npz", **(poses | {"stamps_ns": poses["stamps_ns"] * 2}))
    with refused_as("not_a_truth_folder"):
        read_truth(tmp_path)


def exact_semantics(recording: Recording, stamp_ns: int) -> np.ndarray:
    """A voxel is occupied where the ground passes; 2 where drivable, 3 where not."""
    truth = recording.truth
    centres = (
        np.argwhere(np.ones((*PAPER.shape[:2], 8), bool)) + np.array([0.5, 0.5, 6.5])
    ) * PAPER.voxel_m + np.array(PAPER.min_m)
    verdict = truth.judge(truth.map_from_ego(stamp_ns) @ centres)
    label = np.choose(verdict, [0, 2, 3]).astype(np.uint8)
    semantics = np.zeros(PAPER.shape, np.uint8)
    semantics[:, :, 6:14] = label.reshape(*PAPER.shape[:2], 8)
    return semantics


def judged(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> LabelVerdict:
    """Of two frames whose labels are exact until they are changed."""
    truth = recording.truth
    counts = [
        judge_semantics(
            change(exact_semantics(recording, stamp_ns)), truth.judge, truth.map_from_ego(stamp_ns).as_matrix()
        )
        for stamp_ns in truth.sweep_stamps_ns[:2].tolist()
    ]
    return LabelVerdict(len(counts), *np.sum(counts, axis=0).tolist())


def test_exact_labels_score_one_inverted_ones_zero_and_all_traversable_the_share(recording: Recording) -> None:
    verdict = judged(recording, lambda semantics: semantics)
    assert (verdict.frames, verdict.iou, verdict.precision, verdict.recall) == (2, 1.0, 1.0, 1.0)
    verdict = judged(recording, lambda semantics: np.where(semantics > 0, 1, 0).astype(np.uint8))
    assert verdict.iou == pytest.approx(verdict.everything_iou)
    assert verdict.everything_iou < 0.8
    assert judged(recording, lambda semantics: np.choose(semantics, [0, 0, 3, 2]).astype(np.uint8)).iou == 0.0
    empty = LabelVerdict(1, 0, 0, 0, 0)
    assert (empty.iou, empty.precision, empty.recall, empty.everything_iou) == (None, None, None, None)
    assert empty.as_record()["iou"] is None
