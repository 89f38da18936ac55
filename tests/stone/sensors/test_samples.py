"""Where the robot was when a camera or a radar measured: on the track, refined as the frames are, never beyond it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.samples import egos_at
from stone.sensors.sequence import Frames, Sequence, frame_token

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


@given(st.integers(0, 50), st.integers(0, 11), st.integers(-STEP_NS * 4, STEP_NS * 4))
def test_between_frames_the_robot_is_on_its_track(seed: int, index: int, offset_ns: int) -> None:
    track = track_of(seed)
    stamp_ns = int(np.clip(STAMPS_NS[::EVERY][index] + offset_ns, 0, STAMPS_NS[-1]))
    turns = Slerp(STAMPS_NS, Rotation.from_quat(np.roll(track.map_from_ego.wxyz, -1, axis=1)))
    expected = np.eye(4)
    expected[:3, :3] = turns(stamp_ns).as_matrix()
    expected[:3, 3] = [np.interp(stamp_ns, STAMPS_NS, axis) for axis in track.map_from_ego.translation_m.T]
    np.testing.assert_allclose(matrix(ego_at(sequence_of(track), index, stamp_ns)), expected, atol=1e-9)


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
