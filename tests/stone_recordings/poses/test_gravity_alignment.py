"""A track that began on a slope is turned level by the accelerometer, and only by one that measures gravity."""

from pathlib import Path

import numpy as np
import pytest

from stone.geometry.trajectory import Trajectory
from stone_recordings.bags.bag import open_bag
from stone_recordings.poses.gravity_alignment import LEAST_SAMPLES, imu_topic, levelled
from stone_recordings.poses.sources import PoseTrack
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import T0_NS, header, placed, written
from tests.stone_recordings.writing import Recorded, random_message, serialised

IMU = rigs.MOUNTS[3]
STEP_NS = 5_000_000
POSES_NS = T0_NS + np.arange(0, 8_000_000_001, 50_000_000, dtype=np.int64)
IMU_NS = T0_NS + np.arange(0, 8_000_000_001, 4 * STEP_NS, dtype=np.int64)
SLOPE = placed([np.deg2rad(14), np.deg2rad(-9), 0.3], [5.0, -2.0, 1.0])


def forces(gravity_m_s2: float) -> np.ndarray:
    """What the IMU measures on the circle of the rig: its acceleration by second differences, and gravity."""
    mounted = rigs.EGO_FROM_LIDAR @ IMU.lidar_from_sensor
    before, here, after = (rigs.world_from_ego(IMU_NS + dt) @ mounted for dt in (-STEP_NS, 0, STEP_NS))
    moved = (after.translation_m - 2 * here.translation_m + before.translation_m) / (STEP_NS * 1e-9) ** 2
    return np.einsum("nji,nj->ni", here.rotation(), moved + np.array([0, 0, gravity_m_s2]))


def imu_messages(gravity_m_s2: float = 9.81, count: int | None = None) -> list[Recorded]:
    recorded = []
    for stamp_ns, force in list(zip(IMU_NS.tolist(), forces(gravity_m_s2), strict=True))[:count]:
        message = random_message("sensor_msgs/msg/Imu", np.random.default_rng(0), True)
        message.header = header(stamp_ns, "imu_link")
        for axis, value in zip("xyz", force.tolist(), strict=True):
            setattr(message.linear_acceleration, axis, value)
        recorded.append(Recorded("/imu/data", "sensor_msgs/msg/Imu", stamp_ns, serialised(message)))
    return recorded


def tilted() -> PoseTrack:
    """The true path in a frame that stands on a slope."""
    return PoseTrack(Trajectory(POSES_NS, SLOPE @ rigs.world_from_ego(POSES_NS)), "kiss-icp", "/points")


def levelled_by(path: Path, messages: list[Recorded]) -> PoseTrack:
    with open_bag(written(path, messages)) as bag:
        return levelled(tilted(), imu_topic(bag, "/imu/data", IMU, rigs.EGO_FROM_LIDAR))


def tilt_off_deg(track: PoseTrack) -> np.ndarray:
    """Between the up of each pose and the true one, in the ego frame."""
    found, exact = track.trajectory.map_from_ego.rotation()[:, 2], rigs.world_from_ego(POSES_NS).rotation()[:, 2]
    return np.asarray(np.rad2deg(np.arccos(np.clip((found * exact).sum(axis=1), -1, 1))))


def test_a_drive_that_began_on_a_slope_is_level_within_a_quarter_of_a_degree(tmp_path):
    assert tilt_off_deg(tilted()).min() > 10
    track = levelled_by(tmp_path / "a.mcap", imu_messages())
    assert tilt_off_deg(track).max() < 0.25
    assert "turned by 16." in track.findings[0].message
    assert track.findings[0].severity == "info"


def test_only_the_tilt_is_turned_and_no_distance_changes(tmp_path):
    track = levelled_by(tmp_path / "a.mcap", imu_messages())
    turn = track.trajectory.map_from_ego @ tilted().trajectory.map_from_ego.inverse()
    np.testing.assert_allclose(turn.wxyz, np.tile(turn.wxyz[0], (len(turn), 1)), atol=1e-9)
    assert turn.wxyz[0, 3] == pytest.approx(0.0, abs=1e-9)  # about no upright axis
    np.testing.assert_allclose(turn.translation_m, 0, atol=1e-9)


@pytest.mark.parametrize(
    "messages",
    [imu_messages(gravity_m_s2=1.0), imu_messages(count=LEAST_SAMPLES - 1)],
    ids=["in g", "too few samples"],
)
def test_what_is_no_gravity_turns_nothing_and_is_said(tmp_path, messages):
    track = levelled_by(tmp_path / "a.mcap", messages)
    assert track.trajectory is not None
    np.testing.assert_array_equal(track.trajectory.map_from_ego.wxyz_xyz, tilted().trajectory.map_from_ego.wxyz_xyz)
    assert [(f.code, f.severity) for f in track.findings] == [("SYN-506", "warning")]


def test_without_an_imu_nothing_is_turned():
    assert [f.severity for f in levelled(tilted(), None).findings] == ["warning"]
