"""Drawn worlds: good for the labels' proof, and independent of how they are looked at."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.options import SimulateOptions
from simulator.scenery.movers import WALKER_HEIGHT_M, WALKER_RADIUS_M, cylinder_range
from simulator.scenery.objects import Surface
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.scenery.scene import RayScene, ground_mesh
from simulator.scenery.terrain import Terrain
from simulator.scenery.world import START_NS, SimulatedWorld, build_world
from simulator.sensors.navigation import take_inertia
from simulator.truth import truth_of
from stone.geometry.se3 import SE3


@pytest.fixture(scope="module", params=[1, 2])
def world(request: pytest.FixtureRequest) -> SimulatedWorld:
    return build_world(SimulateOptions(seconds=30.0, seed=request.param))


def driven_m(world: SimulatedWorld, seconds: float) -> np.ndarray:
    return world.trajectory.map_from_ego.translation_m[: int(seconds * 1e9) // POSE_NS]


def test_even_a_short_drive_spans_the_relief_of_the_lowland_around_it(world: SimulatedWorld) -> None:
    height = driven_m(world, 20.0)[:, 2]
    around = world.terrain.lowland & (world.terrain.path_distance_m < 20.0)
    low, high = np.quantile(world.terrain.height_m[around], (0.05, 0.95))
    assert np.ptp(height) > 2.5
    assert height.min() < low + 0.5
    assert height.max() > high - 0.5


def test_the_whole_drive_is_over_drivable_ground(world: SimulatedWorld) -> None:
    truth = truth_of(world, [START_NS])
    assert np.all(truth.judge(driven_m(world, 30.0)) == 1)


def test_half_of_the_ground_near_the_track_cannot_be_driven(world: SimulatedWorld) -> None:
    truth = truth_of(world, [START_NS])
    near = world.terrain.path_distance_m < 25.0
    assert 0.3 < truth.is_drivable[near].mean() < 0.6


def test_no_obstacle_touches_the_robots_way(world: SimulatedWorld) -> None:
    obstacles = world.objects.obstacles
    centres = np.stack([obstacles["x"], obstacles["y"]], axis=-1)
    track = driven_m(world, 30.0)[::20, :2]
    apart = np.linalg.norm(centres[:, None] - track[None], axis=-1).min(axis=1) - obstacles["radius"]
    assert apart.min() > 0.45


def test_every_kind_of_thing_stands_in_the_world(world: SimulatedWorld) -> None:
    kinds = set(world.objects.surface.tolist())
    assert {Surface.ROCK, Surface.BUSH, Surface.TRUNK, Surface.CROWN, Surface.WALL, Surface.GRASS} <= kinds


def test_more_rays_do_not_move_a_tree() -> None:
    options = SimulateOptions(seconds=0.2, seed=5, world_width_m=40.0)
    few, many = build_world(options), build_world(replace(options, channels=128, columns=1800, cameras=False))
    np.testing.assert_array_equal(few.objects.triangles, many.objects.triangles)
    np.testing.assert_array_equal(few.trajectory.map_from_ego.wxyz_xyz, many.trajectory.map_from_ego.wxyz_xyz)


def test_rays_straight_down_meet_the_terrains_own_height() -> None:
    options = SimulateOptions(seconds=0.2, seed=5, world_width_m=40.0)
    world = build_world(options)
    xy = world.trajectory.map_from_ego.translation_m[::20, :2]
    origins = np.concatenate([xy, np.full((len(xy), 1), 30.0)], axis=1).astype(np.float32)
    hits = RayScene(world).cast(origins, np.tile(np.float32([0, 0, -1]), (len(xy), 1)))
    is_ground = hits.surface == Surface.GROUND
    assert is_ground.any()
    np.testing.assert_allclose((30.0 - hits.range_m)[is_ground], world.terrain.elevation_m(xy)[is_ground], atol=0.03)


def test_the_ground_mesh_has_two_triangles_a_cell_facing_up() -> None:
    terrain = Terrain(np.zeros((4, 5)), np.ones((4, 5), bool), np.zeros((4, 5)))
    vertices, faces = ground_mesh(terrain)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    assert len(faces) == 2 * 3 * 4
    assert np.all(normals[:, 2] > 0)


def test_the_walker_is_a_cylinder() -> None:
    foot = np.array([5.0, 0.0, 0.0])
    origins = np.tile(np.float32([0, 0, 1.0]), (4, 1))
    high = np.float32([5.0 - WALKER_RADIUS_M, 0, WALKER_HEIGHT_M])
    high /= np.linalg.norm(high)
    directions = np.stack([np.float32([1, 0, 0]), np.float32([-1, 0, 0]), np.float32([0, 1, 0]), high])
    reach = cylinder_range(foot, origins, directions)
    assert reach[0] == pytest.approx(5.0 - WALKER_RADIUS_M)
    assert np.isinf(reach[1:]).all()


def test_a_robot_at_rest_feels_gravity_alone() -> None:
    still = DriveTrajectory(0, SE3.identity((401,)))
    inertia = take_inertia(still, 400 * POSE_NS, np.random.default_rng(0))
    np.testing.assert_allclose(inertia.linear_acceleration_m_s2.mean(axis=0), [0, 0, 9.80665], atol=0.01)
    np.testing.assert_allclose(inertia.angular_velocity_rad_s.mean(axis=0), 0, atol=1e-3)


def test_a_turning_robot_reports_its_rate() -> None:
    rate = 0.4
    half = rate * np.arange(401) * POSE_NS * 1e-9 / 2
    wxyz = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)
    inertia = take_inertia(
        DriveTrajectory(0, SE3.from_parts(wxyz, np.zeros(3))), 400 * POSE_NS, np.random.default_rng(0)
    )
    np.testing.assert_allclose(inertia.angular_velocity_rad_s.mean(axis=0), [0, 0, rate], atol=1e-3)
