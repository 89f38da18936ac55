"""Single poses off the track cost themselves; poses that never move are told from a robot that stands."""

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.pose_quality import unknown_quality
from stone_recordings.poses.motion_check import is_still
from stone_recordings.poses.sources import PoseTrack
from stone_recordings.poses.track_jumps import split_at_jumps

PERIOD_NS = 100_000_000
STEP_M = 0.3


def track(offsets_m: dict[int, float], count: int = 60, step_m: float = STEP_M) -> PoseTrack:
    """Straight ahead, with some poses beside it."""
    places_m = np.zeros((count, 3))
    places_m[:, 0] = np.arange(count) * step_m
    for row, offset_m in offsets_m.items():
        places_m[row, 1] = offset_m
    poses = SE3.from_parts(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), places_m)
    trajectory = Trajectory(np.arange(count, dtype=np.int64) * PERIOD_NS, poses)
    return PoseTrack(trajectory, "odometry", "/odom", solution=unknown_quality(count))


def codes(found: PoseTrack) -> list[str]:
    return [finding.code for finding in found.findings]


@pytest.mark.parametrize("rows", [[30], [10, 40], [20, 25]])
def test_poses_that_are_alone_off_the_track_are_left_out(rows: list[int]) -> None:
    found = split_at_jumps(track({row: 2.0 + row for row in rows}))
    assert codes(found) == ["GNS-305"]
    assert f"{len(rows)} single poses" in found.findings[0].message
    assert f"{2.0 + rows[-1]:.2f} m at {rows[-1] * PERIOD_NS} ns" in found.findings[0].message
    assert not set(np.array(rows) * PERIOD_NS) & set(found.trajectory.stamps_ns.tolist())
    assert len(found.trajectory) == 60 - len(rows)
    assert found.solution is not None
    assert len(found.solution.rtk) == 60 - len(rows)
    assert not found.trajectory.map_from_ego.translation_m[:, 1].any()


def test_a_track_that_does_not_come_back_is_split_and_keeps_its_poses() -> None:
    found = split_at_jumps(track({row: 5.0 for row in range(30, 60)}))
    assert codes(found) == ["GNS-302"]
    assert len(found.trajectory) == 60


def test_where_many_poses_are_off_nothing_tells_which_are_right() -> None:
    found = split_at_jumps(track({row: 5.0 for row in range(3, 60, 4)}))
    assert "GNS-305" not in codes(found)
    assert len(found.trajectory) == 60


def test_a_sound_track_stays_what_it_is() -> None:
    sound = track({})
    assert split_at_jumps(sound) is sound


def test_poses_stand_where_they_never_move() -> None:
    assert is_still(track({}, step_m=0.0).trajectory)
    assert not is_still(track({}, step_m=0.001).trajectory)
    assert not is_still(track({}, count=1).trajectory)
    turned = track({}, step_m=0.0).trajectory
    wxyz_xyz = turned.map_from_ego.wxyz_xyz.copy()
    wxyz_xyz[30:, :4] = [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]
    assert not is_still(Trajectory(turned.stamps_ns, SE3(wxyz_xyz)))
