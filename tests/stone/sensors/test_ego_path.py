"""Where the robot, a camera and a radar were: on the track, never joined across a break and never beyond it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from stone.geometry.jumps import split
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.deskew import SweepMount
from stone.sensors.ego_path import STEP_M, datum_m, ego_path, maps_of_frames
from stone.sensors.radar_motion import compensated, radar_motion
from stone.sensors.samples import egos_at
from stone.sensors.sequence import Frames, Sequence, frame_token

CALIBRATION = Calibration("none", SE3.identity())
EVERY_NS = 10_000_000


def poses_at(seconds):
    """Along the wave y = sin(x), 1 m a second in x, looking along x."""
    x = np.asarray(seconds, np.float64)
    return SE3.from_parts(np.tile([1.0, 0, 0, 0], (len(x), 1)), np.stack([x, np.sin(x), 0 * x], axis=-1))


def sequence_at(frames_s, track=None):
    stamps_ns = np.round(np.asarray(frames_s) * 1e9).astype(np.int64)
    frames = Frames(stamps_ns, tuple(f"{stamp:032x}" for stamp in stamps_ns.tolist()), poses_at(frames_s))
    return Sequence("way", frames, (), CALIBRATION, "odometry", track=track)


def whole_track(seconds=20.0):
    stamps_ns = np.arange(0, round(seconds * 1e9), EVERY_NS)
    return Trajectory(stamps_ns, poses_at(stamps_ns * 1e-9))


def test_one_sweep_of_a_long_drive_has_the_whole_drive_for_its_way():
    (way,) = ego_path(sequence_at([9.0], whole_track()), 0)
    x, y, _ = way.translation_m.T
    assert (x[0], x[-1]) == pytest.approx((0.0, 19.99))
    assert np.abs(y - np.sin(x)).max() < 1e-12
    gaps_m = np.linalg.norm(np.diff(way.translation_m, axis=0), axis=1)
    assert gaps_m.max() < 2 * STEP_M
    assert len(way) < 0.8 * 2000


def test_stretches_are_apart_and_each_is_a_map_of_its_own_unless_joined():
    broken = split(whole_track(), np.array([999]))
    driven = sequence_at([1.0, 5.0, 12.0, 15.0], broken)
    assert maps_of_frames(driven).tolist() == [0, 0, 1, 1]
    first, second = ego_path(driven, 0), ego_path(driven, 1)
    assert [len(first), len(second)] == [1, 1]
    assert first[0].translation_m[-1, 0] == pytest.approx(9.99)
    assert second[0].translation_m[0, 0] == pytest.approx(10.0)
    joined = replace(driven, map_of_segment=(0, 0))
    assert maps_of_frames(joined).tolist() == [0, 0, 0, 0]
    assert len(ego_path(joined, 0)) == 2


def test_a_stretch_without_a_frame_is_in_no_map():
    broken = split(whole_track(), np.array([499, 999]))
    driven = sequence_at([1.0, 15.0], broken)
    assert [len(ego_path(driven, number)) for number in range(3)] == [1, 0, 1]


def test_a_turn_on_the_spot_keeps_poses_between_though_nothing_moves():
    stamps_ns = np.arange(0, 10**9, EVERY_NS)
    yaw = np.linspace(0, np.pi, len(stamps_ns))
    turning = SE3.from_parts(
        np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=-1), np.zeros((len(yaw), 3))
    )
    (way,) = ego_path(sequence_at([0.5], Trajectory(stamps_ns, turning)), 0)
    assert len(way) > 40


def test_frames_that_were_moved_take_the_track_along():
    whole = whole_track()
    driven = sequence_at([2.0, 8.0, 14.0], whole)
    lift = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([[0, 0, 0.1], [0, 0, 0.3], [0, 0, 0.3]]))
    moved = replace(driven, frames=replace(driven.frames, map_from_ego=lift @ driven.frames.map_from_ego))
    (way,) = ego_path(moved, 0)
    x, _, z = way.translation_m.T
    expected = np.interp(x, [2.0, 8.0, 14.0], [0.1, 0.3, 0.3])
    assert np.abs(z - expected).max() < 1e-9


def test_frames_without_a_track_are_split_where_no_vehicle_goes():
    driven = sequence_at(np.arange(0, 4, 0.1))
    poses = driven.frames.map_from_ego.wxyz_xyz.copy()
    poses[20:, 5] += 30.0
    jumped = replace(driven, frames=replace(driven.frames, map_from_ego=SE3(poses)))
    assert maps_of_frames(jumped).tolist() == [0] * 20 + [1] * 20
    assert [len(ego_path(jumped, number)) for number in (0, 1)] == [1, 1]


def test_no_frames_are_in_no_map():
    assert maps_of_frames(sequence_at([], None)).tolist() == []


def test_a_track_that_begins_without_a_frame_has_its_heights_above_the_first_frames():
    """The heights of no frame were a number that is none, and so was every elevation."""
    broken = split(split(whole_track(), np.array([99])), np.array([99, 999]))
    driven = sequence_at([5.0, 6.0, 12.0], broken)
    assert maps_of_frames(driven).tolist() == [1, 1, 2]
    assert [datum_m(driven, number) for number in (1, 2)] == [0.0, 0.0]
    poses = driven.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 6] = [1.0, 2.0, 7.5]
    raised = replace(driven, frames=replace(driven.frames, map_from_ego=SE3(poses)))
    assert [datum_m(raised, number) for number in (1, 2)] == [0.0, 6.0]


POSES, STEP_NS, EVERY = 60, 20_000_000, 5
STAMPS_NS = np.arange(POSES, dtype=np.int64) * STEP_NS


def ego_at(sequence: Sequence, index: int, stamp_ns: int) -> SE3 | None:
    """`map_from_ego` at a time near frame `index`; None where there is none."""
    poses, is_ok = egos_at(sequence, np.array([index], np.int64), np.array([stamp_ns], np.int64))
    return poses[0] if is_ok[0] else None


def track_of(seed: int, segment: object = None) -> Trajectory:
    """A walk with a pose every 20 ms, turning about all axes."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.normal(0, 0.05, (POSES, 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.02, (POSES, 3)), axis=0)).as_quat()
    return Trajectory(STAMPS_NS, SE3.from_parts(np.roll(turns, 1, axis=1), places), segment)  # type: ignore[arg-type]


def sequence_of(track: Trajectory, is_kept: bool = True) -> Sequence:
    """A frame at every fifth pose."""
    stamps_ns = track.stamps_ns[::EVERY]
    tokens = tuple(frame_token("walk", int(stamp)) for stamp in stamps_ns)
    frames = Frames(stamps_ns, tokens, track.map_from_ego[::EVERY])
    calibration = Calibration("rig", SE3.identity())
    return Sequence("walk", frames, (), calibration, "odometry /odom", track=track if is_kept else None)


def matrix(pose: SE3 | None) -> object:
    assert pose is not None
    return pose.as_matrix()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 50), st.integers(0, 11), st.integers(-STEP_NS * 4, STEP_NS * 4))
def test_between_frames_the_robot_is_on_its_track(seed: int, index: int, offset_ns: int) -> None:
    track = track_of(seed)
    stamp_ns = int(np.clip(STAMPS_NS[::EVERY][index] + offset_ns, 0, STAMPS_NS[-1]))
    turns = Slerp(STAMPS_NS, Rotation.from_quat(np.roll(track.map_from_ego.wxyz, -1, axis=1)))
    expected = np.eye(4)
    expected[:3, :3] = turns(stamp_ns).as_matrix()
    expected[:3, 3] = [np.interp(stamp_ns, STAMPS_NS, axis) for axis in track.map_from_ego.translation_m.T]
    np.testing.assert_allclose(matrix(ego_at(sequence_of(track), index, stamp_ns)), expected, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 50), st.integers(1, 10), st.integers(-STEP_NS * 3, STEP_NS * 3))
def test_refining_a_frame_refines_what_was_measured_near_it(seed: int, index: int, offset_ns: int) -> None:
    sequence = sequence_of(track_of(seed))
    better = SE3.from_parts(np.array([0.9, 0.1, -0.2, 0.3]), np.array([0.3, -0.1, 0.2]))
    refined = replace(sequence, frames=replace(sequence.frames, map_from_ego=better @ sequence.frames.map_from_ego))
    stamp_ns = int(sequence.frames.stamps_ns[index]) + offset_ns
    before, after = (ego_at(one, index, stamp_ns) for one in (sequence, refined))
    assert before is not None
    np.testing.assert_allclose(matrix(after), (better @ before).as_matrix(), atol=1e-9)


def test_at_its_own_stamp_a_frame_has_its_own_pose_to_the_bit() -> None:
    sequence = sequence_of(track_of(1))
    for index, stamp_ns in enumerate(sequence.frames.stamps_ns.tolist()):
        pose = ego_at(sequence, index, stamp_ns)
        assert pose is not None
        assert np.array_equal(pose.wxyz_xyz, sequence.frames.map_from_ego[index].wxyz_xyz)


@pytest.mark.parametrize(("index", "offset_ns"), [(0, -1), (11, 5 * STEP_NS)])
def test_beyond_the_track_there_is_no_pose(index: int, offset_ns: int) -> None:
    sequence = sequence_of(track_of(1))
    assert ego_at(sequence, index, int(sequence.frames.stamps_ns[index]) + offset_ns) is None


def test_beyond_a_jump_there_is_no_pose() -> None:
    segment = (STAMPS_NS[27] < STAMPS_NS).astype(np.int64)
    sequence = sequence_of(track_of(1, segment))
    poses, is_ok = egos_at(sequence, np.array([5, 5, 6]), STAMPS_NS[[27, 28, 28]])
    assert is_ok.tolist() == [True, False, True]
    assert np.isnan(poses.wxyz_xyz[1]).all()
    assert np.isfinite(poses.wxyz_xyz[[0, 2]]).all()


def test_in_a_gap_of_the_track_there_is_no_pose() -> None:
    track = track_of(1)
    kept = np.delete(np.arange(POSES), np.arange(11, 35))
    gap = Trajectory(track.stamps_ns[kept], track.map_from_ego[kept])
    sequence = replace(sequence_of(track), track=gap)
    assert ego_at(sequence, 2, int(STAMPS_NS[15])) is None
    assert ego_at(replace(sequence, max_pose_gap_ns=10**9), 2, int(STAMPS_NS[15])) is not None


def test_without_a_track_the_robot_moved_from_frame_to_frame() -> None:
    sequence = sequence_of(track_of(2), is_kept=False)
    middle = ego_at(sequence, 3, int(sequence.frames.stamps_ns[3]) + EVERY * STEP_NS // 2)
    assert middle is not None
    places = sequence.frames.map_from_ego.translation_m
    np.testing.assert_allclose(middle.translation_m, (places[3] + places[4]) / 2, atol=1e-9)


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


RADAR_STAMPS_NS = np.arange(0, 4_000_000_001, 5_000_000, dtype=np.int64)
MOUNT = SweepMount(Trajectory(RADAR_STAMPS_NS, poses(RADAR_STAMPS_NS)), EGO_FROM_LIDAR)


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
    for taken_ns in (0, int(RADAR_STAMPS_NS[-1])):
        motion = radar_motion(MOUNT, LIDAR_FROM_RADAR, taken_ns, taken_ns)
        assert np.linalg.norm(motion.velocity_m_s) == pytest.approx(5.0, abs=0.5)


def test_without_a_pose_or_beyond_a_jump_nothing_is_known():
    outside = radar_motion(MOUNT, LIDAR_FROM_RADAR, STAMP_NS, int(RADAR_STAMPS_NS[-1]) + 1)
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
