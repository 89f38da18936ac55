"""PoseStamped, PoseWithCovarianceStamped, NavSatFix with an Imu, and files of poses: the path they make, and what is
refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Mount
from stone.sensors.sequence import Sequence
from stone_recordings.poses.file_poses import PoseFile
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.errors import (
    AmbiguousTopicsError,
    NoAttitudeError,
    NoPoseSourceError,
    NoUsablePoseError,
    PoseFileMismatchError,
    WrongTopicError,
)
from testing.worlds.pose_files import kitti_text, tum_text
from tests.stone_recordings import rigs
from tests.stone_recordings.pose_messages import (
    POSED,
    WITH_COVARIANCE,
    attitude_message,
    fix_message,
    pose_message,
)
from tests.stone_recordings.rigs import MOUNTS, ORIGIN, PERIOD_NS, T0_NS, calibration, plain_sweep, written
from tests.stone_recordings.writing import Recorded

STAMPS_NS = T0_NS + np.arange(8) * PERIOD_NS
TRUTH = rigs.world_from_ego(STAMPS_NS)
ANTENNA = Mount("GNSS", "ins", rigs.placed([0.0, 0.0, 0.0], [-0.4, 0.2, 0.5]), "gps_antenna")


def sweeps() -> list[Recorded]:
    return [plain_sweep(int(stamp)) for stamp in STAMPS_NS]


def posed(poses: SE3, type_name: str = POSED, topic: str = "/pose", parent: str = "map") -> list[Recorded]:
    return [pose_message(int(stamp), poses[row], type_name, topic, parent) for row, stamp in enumerate(STAMPS_NS)]


def fixes(status: int = 0, frame_id: str = "gps_antenna", **facts: float) -> list[Recorded]:
    """Positions of the antenna."""
    place_m = (TRUTH @ rigs.EGO_FROM_LIDAR @ ANTENNA.lidar_from_sensor).translation_m
    geodetic = np.stack(pymap3d.enu2geodetic(*place_m.T, *ORIGIN), axis=-1)
    return [
        fix_message(int(stamp), place, status, frame_id, facts)
        for stamp, place in zip(STAMPS_NS, geodetic, strict=True)
    ]


def attitudes(first_covariance: float = 0.01, topic: str = "/imu/data") -> list[Recorded]:
    """Orientations of the IMU at 100 Hz, in east, north, up."""
    stamps_ns = T0_NS - PERIOD_NS + np.arange(100) * 10_000_000
    turned = rigs.world_from_ego(stamps_ns) @ rigs.EGO_FROM_LIDAR @ MOUNTS[3].lidar_from_sensor
    return [
        attitude_message(int(stamp), wxyz, first_covariance, topic)
        for stamp, wxyz in zip(stamps_ns, turned.wxyz, strict=True)
    ]


def synchronised(path: Path, **options: Any) -> Sequence:
    rig = calibration(*MOUNTS, ANTENNA)
    return synchronise(path, rig, SynchroniseOptions(**options), "run")[0]


def codes(sequence: Sequence) -> set[str]:
    return {finding.code for finding in sequence.findings}


def assert_path(sequence: Sequence, expected: SE3 = TRUTH, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(sequence.frames.map_from_ego.as_matrix(), expected.as_matrix(), atol=atol)


@pytest.mark.parametrize("type_name", [POSED, WITH_COVARIANCE])
def test_stamped_poses_are_of_the_ego_frame_unless_a_frame_is_named(tmp_path: Path, type_name: str) -> None:
    sequence = synchronised(written(tmp_path / "a.mcap", sweeps(), posed(TRUTH, type_name)))
    assert_path(sequence)
    assert sequence.pose_source == f"/pose (map to the robot, {type_name})"
    assert "CAL-405" in codes(sequence)
    of_imu = TRUTH @ rigs.EGO_FROM_LIDAR @ MOUNTS[3].lidar_from_sensor
    path = written(tmp_path / "b.mcap", sweeps(), posed(of_imu, type_name))
    named = synchronised(path, poses_frame="imu_link")
    assert_path(named)
    assert "CAL-405" not in codes(named)


def test_stamped_poses_are_taken_where_nothing_better_is_and_goals_never_before_them(tmp_path: Path) -> None:
    goal = pose_message(int(STAMPS_NS[4]), TRUTH[0], POSED, "/goal_pose", "map")
    path = written(tmp_path / "a.mcap", sweeps(), posed(TRUTH), [goal])
    assert_path(synchronised(path))
    assert inspect(path).assignment.channels["pose"] == "/pose"
    odometry = [rigs.odometry(int(stamp), TRUTH[row]) for row, stamp in enumerate(STAMPS_NS)]
    better = synchronised(written(tmp_path / "b.mcap", sweeps(), posed(TRUTH), odometry))
    assert better.pose_source.startswith("/odom ")
    two = written(tmp_path / "c.mcap", sweeps(), posed(TRUTH), posed(TRUTH, topic="/other_pose"))
    with pytest.raises(AmbiguousTopicsError, match=r"role pose: /(pose|other_pose), /"):
        synchronised(two)
    assert_path(synchronised(two, odometry_topic="/other_pose"))


def test_positions_with_an_attitude_are_poses_over_the_lever_arm_of_the_antenna(tmp_path: Path) -> None:
    """The map begins at the first antenna position: that is subtracted from the truth; 2 mm are what slerp between
    samples of 10 ms and the turn of the plumb line over the path leave."""
    sequence = synchronised(written(tmp_path / "a.mcap", sweeps(), fixes(), attitudes()))
    antenna_m = (TRUTH @ rigs.EGO_FROM_LIDAR @ ANTENNA.lidar_from_sensor).translation_m[0]
    expected = SE3.from_parts(TRUTH.wxyz, TRUTH.translation_m - antenna_m)
    assert_path(sequence, expected, atol=2e-3)
    assert sequence.pose_source == "/fix with /imu/data (sensor_msgs/msg/NavSatFix and Imu)"
    assert sequence.map_origin_deg_m is not None
    np.testing.assert_allclose(sequence.map_origin_deg_m[:2], ORIGIN[:2], atol=1e-3)
    assert "GNS-301" in codes(sequence)
    assert "CAL-405" not in codes(sequence)
    assert sequence.frames.associations["IMU"].topic == "/imu/data"


def test_an_antenna_that_nobody_knows_is_said(tmp_path: Path) -> None:
    sequence = synchronised(written(tmp_path / "a.mcap", sweeps(), fixes(frame_id="rover"), attitudes()))
    assert [finding.topic for finding in sequence.findings if finding.code == "CAL-405"] == ["rover"]


def test_positions_without_an_attitude_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NoAttitudeError, match=r"/imu/data: none of its 100 messages.*covariance\[0\] is -1") as refused:
        synchronised(written(tmp_path / "a.mcap", sweeps(), fixes(), attitudes(first_covariance=-1.0)))
    assert refused.value.code == "GNS-306"
    with pytest.raises(NoPoseSourceError, match="/fix"):
        synchronised(written(tmp_path / "b.mcap", sweeps(), fixes()))
    with pytest.raises(NoPoseSourceError, match="/fix"):
        synchronised(written(tmp_path / "c.mcap", sweeps(), fixes()), odometry_topic="/fix")
    with pytest.raises(NoUsablePoseError, match="8 without a fix"):
        synchronised(written(tmp_path / "d.mcap", sweeps(), fixes(status=-1), attitudes()))
    at_ns = int(STAMPS_NS[-1]) + 10**12
    late = [attitude_message(at_ns + row, np.eye(4)[0], 0.1, "/imu/data") for row in range(100)]
    late = [replace(one, log_time_ns=at.log_time_ns) for one, at in zip(late, attitudes(), strict=True)]
    with pytest.raises(NoUsablePoseError, match=r"none has an attitude within 0\.25 s"):
        synchronised(written(tmp_path / "e.mcap", sweeps(), fixes(), late))


def test_of_two_imus_the_attitude_s_is_chosen(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", sweeps(), fixes(), attitudes(), attitudes(-1.0, "/imu/raw"))
    with pytest.raises(AmbiguousTopicsError, match="role imu"):
        synchronised(path)
    assert "/imu/data" in synchronised(path, topics={"imu": "/imu/data"}).pose_source
    with pytest.raises(NoAttitudeError, match="/imu/raw"):
        synchronised(path, topics={"imu": "/imu/raw"})
    with pytest.raises(WrongTopicError, match="sensor_msgs/msg/Imu"):
        synchronised(path, topics={"imu": "/fix"})


def test_some_positions_without_a_fix_are_left_out_and_said(tmp_path: Path) -> None:
    some = fixes()
    some[2] = replace(some[2], payload=fixes(status=-1)[2].payload)
    some[5] = replace(some[5], payload=fixes(latitude=float("nan"))[5].payload)
    sequence = synchronised(written(tmp_path / "a.mcap", sweeps(), some, attitudes()))
    assert len(sequence.frames) == 8
    assert "2 of 8 positions" in next(one.message for one in sequence.findings if one.code == "GNS-303")


def test_a_tum_file_is_the_path_of_the_frame_it_is_of(tmp_path: Path) -> None:
    bag = written(tmp_path / "a.mcap", sweeps())
    stamps_ns = T0_NS - PERIOD_NS + np.arange(40) * 25_000_000
    truth = rigs.world_from_ego(stamps_ns)
    of = {"": truth, "base_link": truth, "CAM_FRONT": truth @ rigs.EGO_FROM_LIDAR @ MOUNTS[1].lidar_from_sensor}
    of["imu_link"] = truth @ rigs.EGO_FROM_LIDAR @ MOUNTS[3].lidar_from_sensor
    for number, (frame, poses) in enumerate(of.items()):
        path = tmp_path / f"{number}.txt"
        path.write_text(tum_text(stamps_ns, poses))
        sequence = synchronised(bag, poses=PoseFile(path, frame))
        assert_path(sequence)
        assert sequence.pose_source == f"{path.name} (TUM)"
        assert ("CAL-405" in codes(sequence)) == (frame == "")


def test_the_hash_of_the_file_is_among_the_inputs_of_the_sequence(tmp_path: Path) -> None:
    """Labels of other poses have other inputs."""
    bag, path = written(tmp_path / "a.mcap", sweeps()), tmp_path / "p.txt"
    found = []
    for shift_m in (0.0, 1.0):
        path.write_text(tum_text(STAMPS_NS, SE3.from_parts(TRUTH.wxyz, TRUTH.translation_m + shift_m)))
        found.append(synchronised(bag, poses=PoseFile(path, "base_link")).inputs)
    assert set(found[0]) == set(found[1]) == {"a.mcap", "poses p.txt"}
    assert found[0]["a.mcap"] == found[1]["a.mcap"]
    assert found[0]["poses p.txt"] != found[1]["poses p.txt"]


def test_a_kitti_file_has_a_pose_for_every_sweep_and_a_map_that_begins_at_the_first(tmp_path: Path) -> None:
    bag, path = written(tmp_path / "a.mcap", sweeps()), tmp_path / "00.txt"
    of_camera = TRUTH @ rigs.EGO_FROM_LIDAR @ MOUNTS[1].lidar_from_sensor
    path.write_text(kitti_text(of_camera[0].inverse() @ of_camera))
    sequence = synchronised(bag, poses=PoseFile(path, "CAM_FRONT"))
    assert_path(sequence, TRUTH[0].inverse() @ TRUTH)
    path.write_text(kitti_text(TRUTH[:7]))
    with pytest.raises(PoseFileMismatchError, match="it has 7 poses, /lidar_points has 8 usable sweeps") as refused:
        synchronised(bag, poses=PoseFile(path, "base_link"))
    assert refused.value.code == "SYN-517"


def test_a_frame_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    bag, path = written(tmp_path / "a.mcap", sweeps()), tmp_path / "p.txt"
    path.write_text(tum_text(STAMPS_NS, TRUTH))
    with pytest.raises(PoseFileMismatchError, match="unknown frame 'chassis'; known are base_link, hesai_lidar"):
        synchronised(bag, poses=PoseFile(path, "chassis"))
