"""A still world seen by a radar that drives and turns: it stands still again, where it would be at the stamp."""

import numpy as np
import pytest

from stone.geometry.jumps import split
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.deskew import SweepMount
from stone.sensors.radar_motion import compensated, radar_motion

STAMP_NS, TAKEN_NS = 2_000_000_000, 2_025_000_000
EGO_FROM_LIDAR = SE3.from_parts(np.array([np.cos(np.pi / 4), 0, 0, -np.sin(np.pi / 4)]), np.array([0.1, 0.0, 0.95]))
LIDAR_FROM_RADAR = SE3.from_parts(np.array([0.9, 0.05, -0.1, 0.4]), np.array([0.3, 0.6, -0.4]))
SPEED_M_S, RATE_RAD_S = 5.0, 0.5


def poses(stamps_ns: np.ndarray) -> SE3:
    """A circle at 5 m/s, turning with it; exact."""
    angle = RATE_RAD_S * stamps_ns * 1e-9
    radius_m = SPEED_M_S / RATE_RAD_S
    place = radius_m * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=-1)
    return SE3.from_parts(np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=-1), place)


STAMPS_NS = np.arange(0, 4_000_000_001, 5_000_000, dtype=np.int64)
MOUNT = SweepMount(Trajectory(STAMPS_NS, poses(STAMPS_NS)), EGO_FROM_LIDAR)


def seen_from(world: np.ndarray, stamp_ns: int) -> np.ndarray:
    map_from_radar = poses(np.array([stamp_ns])) @ EGO_FROM_LIDAR @ LIDAR_FROM_RADAR
    return map_from_radar[0].inverse() @ world


@pytest.fixture
def world() -> np.ndarray:
    return np.random.default_rng(3).uniform(-60, 60, (50, 3))


def range_rates(world: np.ndarray) -> np.ndarray:
    """How the distances grow, by their difference over a microsecond: a slow oracle."""
    before, after = (np.linalg.norm(seen_from(world, TAKEN_NS + dt), axis=1) for dt in (-1_000_000, 1_000_000))
    return np.asarray((after - before) / 2e-3)


def test_a_still_world_stands_still_where_it_would_be_seen_at_the_stamp(world):
    motion = radar_motion(MOUNT, LIDAR_FROM_RADAR, STAMP_NS, TAKEN_NS)
    rates = range_rates(world)
    found = compensated(seen_from(world, TAKEN_NS), rates, motion)
    at_stamp = (poses(np.array([STAMP_NS])) @ EGO_FROM_LIDAR)[0].inverse() @ world
    np.testing.assert_allclose(found.points_lidar, at_stamp, atol=1e-4)
    assert np.abs(rates).max() > 4
    np.testing.assert_allclose(found.ground_rate_m_s, 0, atol=5e-3)
    # Not moved along, they would be 12 cm off.
    assert np.linalg.norm(LIDAR_FROM_RADAR @ seen_from(world, TAKEN_NS) - at_stamp, axis=1).min() > 0.1


def test_what_moves_keeps_its_own_speed(world):
    motion = radar_motion(MOUNT, LIDAR_FROM_RADAR, STAMP_NS, TAKEN_NS)
    own_m_s = np.linspace(-20, 20, len(world))
    found = compensated(seen_from(world, TAKEN_NS), range_rates(world) + own_m_s, motion)
    np.testing.assert_allclose(found.ground_rate_m_s, own_m_s, atol=5e-3)


def test_the_velocity_of_the_radar_has_its_lever_arm_in_it():
    motion = radar_motion(MOUNT, LIDAR_FROM_RADAR, STAMP_NS, TAKEN_NS)
    lever_m = (EGO_FROM_LIDAR @ LIDAR_FROM_RADAR).translation_m
    ego_m_s = np.array([SPEED_M_S, 0, 0]) + np.cross([0, 0, RATE_RAD_S], lever_m)
    radar_from_ego = (EGO_FROM_LIDAR @ LIDAR_FROM_RADAR).inverse()
    np.testing.assert_allclose(motion.velocity_m_s, radar_from_ego.rotation() @ ego_m_s, atol=3e-3)


def test_at_the_ends_of_the_track_one_side_has_to_do():
    for taken_ns in (0, int(STAMPS_NS[-1])):
        motion = radar_motion(MOUNT, LIDAR_FROM_RADAR, taken_ns, taken_ns)
        assert np.linalg.norm(motion.velocity_m_s) == pytest.approx(5.0, abs=0.5)


def test_without_a_pose_or_beyond_a_jump_nothing_is_known():
    outside = radar_motion(MOUNT, LIDAR_FROM_RADAR, STAMP_NS, int(STAMPS_NS[-1]) + 1)
    assert np.isnan(outside.velocity_m_s).all()
    assert np.isnan(outside.stamp_from_radar.wxyz_xyz).all()
    parted = SweepMount(split(MOUNT.trajectory, np.array([402])), EGO_FROM_LIDAR)
    assert np.isnan(radar_motion(parted, LIDAR_FROM_RADAR, STAMP_NS, TAKEN_NS).velocity_m_s).all()
    beside = radar_motion(parted, LIDAR_FROM_RADAR, TAKEN_NS, TAKEN_NS)
    np.testing.assert_allclose(
        beside.velocity_m_s, radar_motion(MOUNT, LIDAR_FROM_RADAR, TAKEN_NS, TAKEN_NS).velocity_m_s, atol=0.15
    )


def test_a_detection_in_the_radar_itself_has_no_direction():
    motion = radar_motion(MOUNT, LIDAR_FROM_RADAR, STAMP_NS, TAKEN_NS)
    found = compensated(np.zeros((1, 3)), np.ones(1), motion)
    assert np.isnan(found.ground_rate_m_s).all()
    assert np.isfinite(found.points_lidar).all()
    assert compensated(np.zeros((0, 3)), np.zeros(0), motion).points_lidar.shape == (0, 3)
