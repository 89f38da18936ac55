"""The way of the robot follows its track, pose by pose, and is never joined where the track breaks."""

from dataclasses import replace

import numpy as np
import pytest

from stone.geometry.jumps import split
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.ego_path import STEP_M, datum_m, ego_path, maps_of_frames
from stone.sensors.sequence import Frames, Sequence

CALIBRATION = Calibration("none", SE3.identity())
EVERY_NS = 10_000_000


def poses_at(seconds):
    """Along the wave y = sin(x), 1 m a second in x, looking along x."""
    x = np.asarray(seconds, np.float64)
    return SE3.from_parts(np.tile([1.0, 0, 0, 0], (len(x), 1)), np.stack([x, np.sin(x), 0 * x], axis=-1))


def sequence(frames_s, track=None):
    stamps_ns = np.round(np.asarray(frames_s) * 1e9).astype(np.int64)
    frames = Frames(stamps_ns, tuple(f"{stamp:032x}" for stamp in stamps_ns.tolist()), poses_at(frames_s))
    return Sequence("way", frames, (), CALIBRATION, "odometry", track=track)


def track(seconds=20.0):
    stamps_ns = np.arange(0, round(seconds * 1e9), EVERY_NS)
    return Trajectory(stamps_ns, poses_at(stamps_ns * 1e-9))


def test_one_sweep_of_a_long_drive_has_the_whole_drive_for_its_way():
    (way,) = ego_path(sequence([9.0], track()), 0)
    x, y, _ = way.translation_m.T
    assert (x[0], x[-1]) == pytest.approx((0.0, 19.99))
    assert np.abs(y - np.sin(x)).max() < 1e-12
    gaps_m = np.linalg.norm(np.diff(way.translation_m, axis=0), axis=1)
    assert gaps_m.max() < 2 * STEP_M
    assert len(way) < 0.8 * 2000


def test_between_two_frames_the_way_is_the_tracks_and_no_straight_line():
    (way,) = ego_path(sequence([0.0, 3.0], track()), 0)
    x, y, _ = way.translation_m.T
    assert np.abs(y - np.sin(x)).max() < 1e-12


def test_stretches_are_apart_and_each_is_a_map_of_its_own_unless_joined():
    broken = split(track(), np.array([999]))
    driven = sequence([1.0, 5.0, 12.0, 15.0], broken)
    assert maps_of_frames(driven).tolist() == [0, 0, 1, 1]
    first, second = ego_path(driven, 0), ego_path(driven, 1)
    assert [len(first), len(second)] == [1, 1]
    assert first[0].translation_m[-1, 0] == pytest.approx(9.99)
    assert second[0].translation_m[0, 0] == pytest.approx(10.0)
    joined = replace(driven, map_of_segment=(0, 0))
    assert maps_of_frames(joined).tolist() == [0, 0, 0, 0]
    assert len(ego_path(joined, 0)) == 2


def test_a_stretch_without_a_frame_is_in_no_map():
    broken = split(track(), np.array([499, 999]))
    driven = sequence([1.0, 15.0], broken)
    assert [len(ego_path(driven, number)) for number in range(3)] == [1, 0, 1]


def test_a_turn_on_the_spot_keeps_poses_between_though_nothing_moves():
    stamps_ns = np.arange(0, 10**9, EVERY_NS)
    yaw = np.linspace(0, np.pi, len(stamps_ns))
    turning = SE3.from_parts(
        np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=-1), np.zeros((len(yaw), 3))
    )
    (way,) = ego_path(sequence([0.5], Trajectory(stamps_ns, turning)), 0)
    assert len(way) > 40


def test_frames_that_were_moved_take_the_track_along():
    whole = track()
    driven = sequence([2.0, 8.0, 14.0], whole)
    lift = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([[0, 0, 0.1], [0, 0, 0.3], [0, 0, 0.3]]))
    moved = replace(driven, frames=replace(driven.frames, map_from_ego=lift @ driven.frames.map_from_ego))
    (way,) = ego_path(moved, 0)
    x, _, z = way.translation_m.T
    expected = np.interp(x, [2.0, 8.0, 14.0], [0.1, 0.3, 0.3])
    assert np.abs(z - expected).max() < 1e-9


def test_frames_without_a_track_are_split_where_no_vehicle_goes():
    driven = sequence(np.arange(0, 4, 0.1))
    poses = driven.frames.map_from_ego.wxyz_xyz.copy()
    poses[20:, 5] += 30.0
    jumped = replace(driven, frames=replace(driven.frames, map_from_ego=SE3(poses)))
    assert maps_of_frames(jumped).tolist() == [0] * 20 + [1] * 20
    assert [len(ego_path(jumped, number)) for number in (0, 1)] == [1, 1]


def test_no_frames_are_in_no_map():
    assert maps_of_frames(sequence([], None)).tolist() == []


def test_a_track_that_begins_without_a_frame_has_its_heights_above_the_first_frames():
    """The heights of no frame were a number that is none, and so was every elevation."""
    broken = split(split(track(), np.array([99])), np.array([99, 999]))
    driven = sequence([5.0, 6.0, 12.0], broken)
    assert maps_of_frames(driven).tolist() == [1, 1, 2]
    assert [datum_m(driven, number) for number in (1, 2)] == [0.0, 0.0]
    poses = driven.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 6] = [1.0, 2.0, 7.5]
    raised = replace(driven, frames=replace(driven.frames, map_from_ego=SE3(poses)))
    assert [datum_m(raised, number) for number in (1, 2)] == [0.0, 6.0]
