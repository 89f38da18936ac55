"""Odometry and TF recordings: which pose source is taken, over which mounts, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.sequence import Sequence
from stone_recordings.bags.errors import NotABagError
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.poses.extrinsics import static_tree
from stone_recordings.poses.file_poses import PoseFile
from stone_recordings.poses.sources import RigMounts, track_from_odometry
from stone_recordings.report.inspection import inspect
from stone_recordings.sync import errors
from testing.refusals import refused_as
from testing.worlds.pose_files import kitti_text, tum_text
from tests.stone_recordings import rigs
from tests.stone_recordings.pose_messages import POSED, WITH_COVARIANCE, attitude_message, fix_message, pose_message
from tests.stone_recordings.writing import Recorded

STAMPS_NS = rigs.T0_NS + np.arange(8) * rigs.PERIOD_NS
TRUTH = rigs.world_from_ego(STAMPS_NS)


def sweeps(stamps_ns=STAMPS_NS):
    return [rigs.plain_sweep(int(stamp)) for stamp in stamps_ns]


def odometry(poses: SE3 = TRUTH, **facts):
    return [rigs.odometry(int(stamp), poses[i], **facts) for i, stamp in enumerate(STAMPS_NS)]


def synchronised(path: Path, cal: Calibration | None = None, **options):
    return synchronise(path, cal or rigs.calibration(), SynchroniseOptions(**options), "run")


def codes(sequence) -> set[str]:
    """Random points show no ground, which CAL-435 says."""
    return {finding.code for finding in sequence.findings} - {"CAL-435"}


def assert_path(sequence: Sequence, expected: SE3 = TRUTH, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(sequence.frames.map_from_ego.as_matrix(), expected.as_matrix(), atol=atol)


def test_the_base_link_of_odometry_is_the_ego_frame(tmp_path):
    sequence, source = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry()))
    assert_path(sequence)
    assert sequence.pose_source == "/odom (odom to base_link, nav_msgs/msg/Odometry)"
    assert sequence.map_origin_deg_m is None
    assert codes(sequence) == {"TOP-102"}
    assert source.sweep(3).points_lidar.shape == (1200, 3)


def test_odometry_of_the_lidar_is_carried_to_the_ego_frame_and_of_nobody_s_frame_is_taken_for_it(tmp_path):
    of_lidar = TRUTH @ rigs.EGO_FROM_LIDAR
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry(of_lidar, child=rigs.LIDAR_FRAME)))
    assert_path(sequence)
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry(child="chassis")))
    assert_path(sequence)
    assert "CAL-405" in codes(sequence)


@pytest.mark.parametrize(
    ("parent", "child", "sensor"),
    [
        ("camera_init", "body", "IMU"), ("/camera_init", "/aft_mapped", "IMU or LiDAR"),
        ("odom", "imu_sensor", "IMU"), ("map", "velodyne_top", "LiDAR"), ("odom", "zed2_left_camera_frame", "camera"),
        ("odom", "gps_antenna", "receiver"),
    ],
)  # fmt: skip
def test_a_sensor_that_nobody_places_is_named_with_what_to_add(tmp_path, parent, child, sensor):
    poses = odometry(parent=parent, child=child)
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), poses))
    finding = next(f for f in sequence.findings if f.code == "CAL-405")
    assert (finding.severity, finding.topic) == ("warning", child)
    assert f"indicates the {sensor}," in finding.message


@pytest.mark.parametrize(("parent", "child"), [("odom", "body"), ("camera_init", "base_link"), ("map", "base")])
def test_the_base_of_a_robot_is_not_taken_for_a_sensor(tmp_path, parent, child):
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry(parent=parent, child=child)))
    assert "CAL-405" not in codes(sequence)


def test_an_imu_under_camera_init_that_the_calibration_places_is_carried_over_its_mount(tmp_path):
    """FAST-LIO's `body`, entered as the frame of the IMU's mount."""
    rig = rigs.calibration()
    mounts = tuple(replace(mount, frame_id="body") if mount.kind == "imu" else mount for mount in rig.mounts)
    of_imu = TRUTH @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[3].lidar_from_sensor
    bag = rigs.written(tmp_path / "a.mcap", sweeps(), odometry(of_imu, parent="camera_init", child="body"))
    sequence, _ = synchronise(bag, replace(rig, mounts=mounts), SynchroniseOptions(), "run")
    assert_path(sequence)
    assert "CAL-405" not in codes(sequence)


def test_tf_static_is_followed_along_the_tree_and_silent_where_it_agrees(tmp_path):
    static = [rigs.transform("/tf_static", rigs.T0_NS, "base_link", rigs.LIDAR_FRAME, rigs.EGO_FROM_LIDAR)]
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry(), static))
    assert_path(sequence)
    assert codes(sequence) == {"TOP-102"}
    middle = rigs.placed([0.1, 0.2, 0.3], [1.0, 2.0, 3.0])
    static = [
        rigs.transform("/tf_static", rigs.T0_NS, "base_link", "mast", middle),
        rigs.transform("/tf_static", rigs.T0_NS + 1, "mast", rigs.LIDAR_FRAME, middle.inverse() @ rigs.EGO_FROM_LIDAR),
        rigs.transform("/tf_static", rigs.T0_NS + 2, rigs.LIDAR_FRAME, "radar", rigs.placed([0, 0, 0], [0.0, 0.6, 0])),
    ]
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry(), static))
    assert_path(sequence)
    assert [f.topic for f in sequence.findings if f.code == "CAL-414"] == ["RADAR_LEFT"]


def test_tf_static_that_disagrees_is_a_warning_and_the_path_of_the_lidar_stays(tmp_path):
    """2 cm and 1° off: the calibration says where the ego frame is, the recording where the LiDAR went."""
    base_from_lidar = rigs.placed([0.0, 0.0, np.deg2rad(1)], [0.0, 0.0, 0.02]) @ rigs.EGO_FROM_LIDAR
    static = [rigs.transform("/tf_static", rigs.T0_NS, "base_link", rigs.LIDAR_FRAME, base_from_lidar)]
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), odometry(), static))
    finding = next(f for f in sequence.findings if f.code == "CAL-414")
    assert (finding.severity, finding.topic) == ("warning", "ego_from_lidar")
    assert "1.00°" in finding.message
    map_from_lidar = sequence.frames.map_from_ego @ rigs.EGO_FROM_LIDAR
    np.testing.assert_allclose(map_from_lidar.as_matrix(), (TRUTH @ base_from_lidar).as_matrix(), atol=1e-9)


def test_tf_is_taken_when_there_is_nothing_better(tmp_path):
    moving = [rigs.transform("/tf", int(s), "odom", "base_link", TRUTH[i]) for i, s in enumerate(STAMPS_NS)]
    moving += [rigs.transform("/tf", int(s), "base_link", "wheel", SE3.identity()) for s in STAMPS_NS]
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", sweeps(), moving))
    assert_path(sequence)
    assert sequence.pose_source == "/tf (odom to base_link, tf2_msgs/msg/TFMessage)"


@pytest.mark.parametrize("source", ["odometry", "tf"])
def test_messages_without_a_pose_cost_themselves_alone_and_are_named(tmp_path, source):
    nowhere = SE3(TRUTH.wxyz_xyz.copy())
    nowhere.wxyz_xyz[3, 4] = np.nan
    nowhere.wxyz_xyz[5, :4] = 0.0
    moving = [rigs.transform("/tf", int(s), "odom", "base_link", nowhere[i]) for i, s in enumerate(STAMPS_NS)]
    path = rigs.written(tmp_path / "a.mcap", sweeps(), odometry(nowhere) if source == "odometry" else moving)
    sequence, _ = synchronised(path)
    assert len(sequence.frames) == 8
    finding = next(finding for finding in sequence.findings if finding.code == "MSG-305")
    assert str(STAMPS_NS[3]) in finding.message
    assert str(STAMPS_NS[5]) in finding.message
    assert "2 messages contain no pose" in finding.message
    told = [one for one in inspect(path).findings if one.code == "MSG-305"]
    assert told == ([finding] if source == "odometry" else [])


LATE_NS = 18 * 10**9


def test_a_lidar_on_another_clock_is_put_right_by_the_calibration_or_the_command(tmp_path):
    late = [rigs.plain_sweep(int(stamp) + LATE_NS) for stamp in STAMPS_NS]
    path = rigs.written(tmp_path / "a.mcap", late, odometry())
    with refused_as("SYN-501", match=r"\+18\.000 s apart at the start"):
        synchronised(path)
    lidar = Mount("LIDAR_TOP", "lidar", SE3.identity(), rigs.LIDAR_FRAME, -LATE_NS)
    known = replace(rigs.calibration(), mounts=(*rigs.calibration().mounts, lidar))
    for cal, options in ((known, {}), (rigs.calibration(), {"time_offsets_ns": {"lidar": -LATE_NS}})):
        sequence, source = synchronised(path, cal, **options)
        assert_path(sequence)
        assert sequence.frames.stamps_ns.tolist() == STAMPS_NS.tolist()
        assert source.sweep(3).stamp_ns == STAMPS_NS[3]
        assert "TIM-214" in codes(sequence)


def test_poses_on_another_clock_are_put_right_by_the_calibration_or_the_command(tmp_path):
    stamps_ns = STAMPS_NS + LATE_NS
    late = [rigs.odometry(int(stamp), TRUTH[i], child="imu_link") for i, stamp in enumerate(stamps_ns)]
    path = rigs.written(tmp_path / "a.mcap", sweeps(), late)
    mounts = tuple(
        replace(mount, time_offset_ns=-LATE_NS) if mount.frame_id == "imu_link" else mount
        for mount in rigs.calibration().mounts
    )
    for cal, options in (
        (replace(rigs.calibration(), mounts=mounts), {}),
        (rigs.calibration(), {"time_offsets_ns": {"pose": -LATE_NS}}),
    ):
        sequence, _ = synchronised(path, cal, **options)
        assert len(sequence.frames) == 8
        assert "TIM-214" in codes(sequence)


def test_the_topic_asked_for_wins(tmp_path):
    other = odometry(TRUTH @ rigs.placed([0, 0, 0], [5.0, 0, 0]), topic="/wheel")
    path = rigs.written(tmp_path / "a.mcap", sweeps(), odometry(), other)
    with refused_as("TOP-110", match="2 topics fit the role odometry: /odom, /wheel; choose one with"):
        synchronised(path)
    sequence, _ = synchronised(path, odometry_topic=rigs.ODOM_TOPIC)
    assert_path(sequence)
    for asked in ("/nothing", rigs.LIDAR_TOPIC):
        with refused_as("TOP-104"):
            synchronised(path, odometry_topic=asked)


def test_a_recording_without_poses_or_with_those_of_other_days_is_refused(tmp_path):
    with refused_as("SYN-502"):
        synchronised(rigs.written(tmp_path / "a.mcap", sweeps()))
    wheel = [rigs.transform("/tf", rigs.T0_NS, "base_link", "wheel", SE3.identity())]
    with refused_as("SYN-502"):
        synchronised(rigs.written(tmp_path / "b.mcap", sweeps(), wheel))
    with refused_as("SYN-501", match="8 no_pose_after_last"):
        synchronised(rigs.written(tmp_path / "a.mcap", sweeps(STAMPS_NS + 3_600_000_000_000), odometry()))
    rig = RigMounts(rigs.calibration(), static_tree(()), rigs.LIDAR_FRAME)
    with pytest.raises(errors.NoUsablePoseError):
        track_from_odometry([], rigs.ODOM_TOPIC, rig)


def test_a_recording_without_lidar_is_refused(tmp_path):
    with refused_as("TOP-101"):
        synchronised(rigs.written(tmp_path / "a.mcap", odometry()))
    two = [rigs.plain_sweep(int(s)) for s in STAMPS_NS]
    second = [type(m)("/lidar_rear", m.type, m.log_time_ns, m.payload) for m in two]
    path = rigs.written(tmp_path / "b.mcap", two, second, odometry())
    with refused_as("TOP-110", match="role lidar: /lidar_points, /lidar_rear"):
        synchronised(path)
    assert len(synchronised(path, lidar_topic="/lidar_rear")[0].frames) == 8


def test_stamps_that_go_back_or_repeat_are_sorted_out_and_said(tmp_path):
    order = [0, 1, 3, 2, 4, 5, 5, 6, 7]
    shuffled = [
        type(m)(m.topic, m.type, int(rigs.T0_NS + place * rigs.PERIOD_NS), m.payload)
        for place, m in enumerate(rigs.plain_sweep(int(STAMPS_NS[i])) for i in order)
    ]
    backwards = [
        type(m)(m.topic, m.type, int(rigs.T0_NS + place * rigs.PERIOD_NS), m.payload)
        for place, m in enumerate(reversed(odometry()))
    ]
    sequence, source = synchronised(rigs.written(tmp_path / "a.mcap", shuffled, backwards))
    assert sequence.frames.stamps_ns.tolist() == STAMPS_NS.tolist()
    assert_path(sequence)
    assert {"TIM-203", "TIM-206"} <= codes(sequence)
    assert source.message_index.tolist() == [0, 1, 3, 2, 4, 5, 7, 8]


def test_an_empty_sweep_is_excluded(tmp_path):
    some = sweeps()
    some[2] = rigs.plain_sweep(int(STAMPS_NS[2]), count=0)
    sequence, _ = synchronised(rigs.written(tmp_path / "a.mcap", some, odometry()))
    assert [(e.code, e.stamp_ns) for e in sequence.excluded] == [("empty_sweep", STAMPS_NS[2])]
    only = [rigs.plain_sweep(int(s), count=0) for s in STAMPS_NS]
    with refused_as("SYN-501", match="8 empty_sweep"):
        synchronised(rigs.written(tmp_path / "b.mcap", only, odometry()), lidar_topic=rigs.LIDAR_TOPIC)


def test_hostile_files_are_refused(tmp_path):
    page = tmp_path / "page.mcap"
    page.write_text("<html><body>404</body></html>")
    with pytest.raises(NotABagError):
        synchronised(page)
    lying = [rigs.plain_sweep(int(s), offset_of_x=60_000) for s in STAMPS_NS]
    with refused_as("TOP-101"):
        synchronised(rigs.written(tmp_path / "lies.mcap", lying, odometry()))
    one = sweeps()
    one[6] = rigs.plain_sweep(int(STAMPS_NS[6]), point_step=17, row_step=3)
    sequence, source = synchronised(rigs.written(tmp_path / "late.mcap", one, odometry()))
    assert [source.sweep(frame).stamp_ns for frame in range(7)] == [*STAMPS_NS[:6].tolist(), int(STAMPS_NS[7])]
    assert [(frame.stamp_ns, frame.code) for frame in sequence.excluded] == [(STAMPS_NS[6], "malformed_sweep")]
    assert "17 bytes" in sequence.excluded[0].reason
    assert {"MSG-303", "SYN-501"} <= codes(sequence)


@pytest.mark.whole
@pytest.mark.field_data
def test_the_real_drive_gives_every_sweep_as_a_frame(field_data):
    root = Path(__file__).parents[3]
    cal, _ = read_calibration(root / "examples" / "kitti0005.calibration.yaml")
    bag = field_data / "kitti0005_ros2_mcap" / "kitti0005_lidar_odom.mcap"
    sequence, source = synchronise(bag, cal, SynchroniseOptions(), "kitti0005")
    assert (len(sequence.frames), sequence.excluded) == (154, ())
    assert codes(sequence) == {"CAL-414", "TOP-102"}
    steps_m = np.linalg.norm(np.diff(sequence.frames.map_from_ego.translation_m, axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(71, abs=2)
    assert steps_m.max() < 1.5
    for index in (0, 77, 153):
        ego = cal.ego_from_lidar @ source.sweep(index).points_lidar.astype(np.float64)
        is_road = (np.abs(ego[:, 1]) < 1) & (np.abs(ego[:, 0]) > 4.6) & (np.abs(ego[:, 0]) < 8) & (ego[:, 2] < 0.3)
        assert abs(np.median(ego[is_road, 2])) < 0.05


ANTENNA = Mount("GNSS", "ins", rigs.placed([0.0, 0.0, 0.0], [-0.4, 0.2, 0.5]), "gps_antenna")


def posed(poses: SE3, type_name: str = POSED, topic: str = "/pose", parent: str = "map") -> list[Recorded]:
    return [pose_message(int(stamp), poses[row], type_name, topic, parent) for row, stamp in enumerate(STAMPS_NS)]


def fixes(status: int = 0, frame_id: str = "gps_antenna", **facts: float) -> list[Recorded]:
    """Positions of the antenna."""
    place_m = (TRUTH @ rigs.EGO_FROM_LIDAR @ ANTENNA.lidar_from_sensor).translation_m
    geodetic = np.stack(pymap3d.enu2geodetic(*place_m.T, *rigs.ORIGIN), axis=-1)
    return [
        fix_message(int(stamp), place, status, frame_id, facts)
        for stamp, place in zip(STAMPS_NS, geodetic, strict=True)
    ]


def attitudes(first_covariance: float = 0.01, topic: str = "/imu/data") -> list[Recorded]:
    """Orientations of the IMU at 100 Hz, in east, north, up."""
    stamps_ns = rigs.T0_NS - rigs.PERIOD_NS + np.arange(100) * 10_000_000
    turned = rigs.world_from_ego(stamps_ns) @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[3].lidar_from_sensor
    return [
        attitude_message(int(stamp), wxyz, first_covariance, topic)
        for stamp, wxyz in zip(stamps_ns, turned.wxyz, strict=True)
    ]


def sequence_of(path: Path, **options: Any) -> Sequence:
    rig = rigs.calibration(*rigs.MOUNTS, ANTENNA)
    return synchronise(path, rig, SynchroniseOptions(**options), "run")[0]


@pytest.mark.parametrize("type_name", [POSED, WITH_COVARIANCE])
def test_stamped_poses_are_of_the_ego_frame_unless_a_frame_is_named(tmp_path: Path, type_name: str) -> None:
    sequence = sequence_of(rigs.written(tmp_path / "a.mcap", sweeps(), posed(TRUTH, type_name)))
    assert_path(sequence)
    assert sequence.pose_source == f"/pose (map to the robot, {type_name})"
    assert "CAL-405" in codes(sequence)
    of_imu = TRUTH @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[3].lidar_from_sensor
    path = rigs.written(tmp_path / "b.mcap", sweeps(), posed(of_imu, type_name))
    named = sequence_of(path, poses_frame="imu_link")
    assert_path(named)
    assert "CAL-405" not in codes(named)


def test_stamped_poses_are_taken_where_nothing_better_is_and_goals_never_before_them(tmp_path: Path) -> None:
    goal = pose_message(int(STAMPS_NS[4]), TRUTH[0], POSED, "/goal_pose", "map")
    path = rigs.written(tmp_path / "a.mcap", sweeps(), posed(TRUTH), [goal])
    assert_path(sequence_of(path))
    assert inspect(path).assignment.channels["pose"] == "/pose"
    odometry = [rigs.odometry(int(stamp), TRUTH[row]) for row, stamp in enumerate(STAMPS_NS)]
    better = sequence_of(rigs.written(tmp_path / "b.mcap", sweeps(), posed(TRUTH), odometry))
    assert better.pose_source.startswith("/odom ")
    two = rigs.written(tmp_path / "c.mcap", sweeps(), posed(TRUTH), posed(TRUTH, topic="/other_pose"))
    with refused_as("TOP-110", match=r"role pose: /(pose|other_pose), /"):
        sequence_of(two)
    assert_path(sequence_of(two, odometry_topic="/other_pose"))


def test_positions_with_an_attitude_are_poses_over_the_lever_arm_of_the_antenna(tmp_path: Path) -> None:
    """The map begins within a metre of the first antenna position: its origin is subtracted from the truth; 2 mm are
    what slerp between samples of 10 ms and the turn of the plumb line over the path leave."""
    sequence = sequence_of(rigs.written(tmp_path / "a.mcap", sweeps(), fixes(), attitudes()))
    assert sequence.map_origin_deg_m is not None
    origin_m = np.array(pymap3d.geodetic2enu(*sequence.map_origin_deg_m, *rigs.ORIGIN))
    antenna_m = (TRUTH @ rigs.EGO_FROM_LIDAR @ ANTENNA.lidar_from_sensor).translation_m[0]
    assert np.abs(origin_m - antenna_m).max() <= 0.51
    assert_path(sequence, SE3.from_parts(TRUTH.wxyz, TRUTH.translation_m - origin_m), atol=2e-3)
    assert sequence.pose_source == "/fix with /imu/data (sensor_msgs/msg/NavSatFix and Imu)"
    assert "GNS-301" in codes(sequence)
    assert "CAL-405" not in codes(sequence)
    assert sequence.frames.associations["IMU"].topic == "/imu/data"


def test_an_antenna_that_nobody_knows_and_positions_without_a_fix_are_said(tmp_path: Path) -> None:
    sequence = sequence_of(rigs.written(tmp_path / "a.mcap", sweeps(), fixes(frame_id="rover"), attitudes()))
    assert [finding.topic for finding in sequence.findings if finding.code == "CAL-405"] == ["rover"]
    some = fixes()
    some[2] = replace(some[2], payload=fixes(status=-1)[2].payload)
    some[5] = replace(some[5], payload=fixes(latitude=float("nan"))[5].payload)
    sequence = sequence_of(rigs.written(tmp_path / "a.mcap", sweeps(), some, attitudes()))
    assert len(sequence.frames) == 8
    assert "2 of 8 positions" in next(one.message for one in sequence.findings if one.code == "GNS-303")


def test_positions_without_an_attitude_are_refused(tmp_path: Path) -> None:
    with refused_as("GNS-306", match=r"/imu/data: none of its 100 messages.*covariance\[0\] is -1") as refused:
        sequence_of(rigs.written(tmp_path / "a.mcap", sweeps(), fixes(), attitudes(first_covariance=-1.0)))
    assert refused.value.code == "GNS-306"
    with refused_as("SYN-502"):
        sequence_of(rigs.written(tmp_path / "b.mcap", sweeps(), fixes()))
    with refused_as("SYN-502"):
        sequence_of(rigs.written(tmp_path / "c.mcap", sweeps(), fixes()), odometry_topic="/fix")
    with pytest.raises(errors.NoUsablePoseError, match="8 without a fix"):
        sequence_of(rigs.written(tmp_path / "d.mcap", sweeps(), fixes(status=-1), attitudes()))
    at_ns = int(STAMPS_NS[-1]) + 10**12
    late = [attitude_message(at_ns + row, np.eye(4)[0], 0.1, "/imu/data") for row in range(100)]
    late = [replace(one, log_time_ns=at.log_time_ns) for one, at in zip(late, attitudes(), strict=True)]
    with pytest.raises(errors.NoUsablePoseError):
        sequence_of(rigs.written(tmp_path / "e.mcap", sweeps(), fixes(), late))


def test_of_two_imus_the_attitude_s_is_chosen(tmp_path: Path) -> None:
    path = rigs.written(tmp_path / "a.mcap", sweeps(), fixes(), attitudes(), attitudes(-1.0, "/imu/raw"))
    with refused_as("TOP-110", match="role imu"):
        sequence_of(path)
    assert "/imu/data" in sequence_of(path, topics={"imu": "/imu/data"}).pose_source
    with refused_as("GNS-306"):
        sequence_of(path, topics={"imu": "/imu/raw"})
    with refused_as("TOP-104"):
        sequence_of(path, topics={"imu": "/fix"})


def test_a_tum_file_is_the_path_of_the_frame_it_is_of(tmp_path: Path) -> None:
    bag = rigs.written(tmp_path / "a.mcap", sweeps())
    stamps_ns = rigs.T0_NS - rigs.PERIOD_NS + np.arange(40) * 25_000_000
    truth = rigs.world_from_ego(stamps_ns)
    of = {"": truth, "base_link": truth, "CAM_FRONT": truth @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[1].lidar_from_sensor}
    of["imu_link"] = truth @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[3].lidar_from_sensor
    for number, (frame, poses) in enumerate(of.items()):
        path = tmp_path / f"{number}.txt"
        path.write_text(tum_text(stamps_ns, poses))
        sequence = sequence_of(bag, poses=PoseFile(path, frame))
        assert_path(sequence)
        assert sequence.pose_source == f"{path.name} (TUM)"
        assert ("CAL-405" in codes(sequence)) == (frame == "")


def test_the_hash_of_the_file_is_among_the_inputs_and_an_unknown_frame_refused(tmp_path: Path) -> None:
    """Labels of other poses have other inputs."""
    bag, path = rigs.written(tmp_path / "a.mcap", sweeps()), tmp_path / "p.txt"
    found = []
    for shift_m in (0.0, 1.0):
        path.write_text(tum_text(STAMPS_NS, SE3.from_parts(TRUTH.wxyz, TRUTH.translation_m + shift_m)))
        found.append(sequence_of(bag, poses=PoseFile(path, "base_link")).inputs)
    assert set(found[0]) == set(found[1]) == {"a.mcap", "poses p.txt"}
    assert found[0]["a.mcap"] == found[1]["a.mcap"]
    assert found[0]["poses p.txt"] != found[1]["poses p.txt"]
    bag, path = rigs.written(tmp_path / "a.mcap", sweeps()), tmp_path / "p.txt"
    path.write_text(tum_text(STAMPS_NS, TRUTH))
    with refused_as("SYN-517"):
        sequence_of(bag, poses=PoseFile(path, "chassis"))


def test_a_kitti_file_has_a_pose_for_every_sweep_and_a_map_that_begins_at_the_first(tmp_path: Path) -> None:
    bag, path = rigs.written(tmp_path / "a.mcap", sweeps()), tmp_path / "00.txt"
    of_camera = TRUTH @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[1].lidar_from_sensor
    path.write_text(kitti_text(of_camera[0].inverse() @ of_camera))
    sequence = sequence_of(bag, poses=PoseFile(path, "CAM_FRONT"))
    assert_path(sequence, TRUTH[0].inverse() @ TRUTH)
    path.write_text(kitti_text(TRUTH[:7]))
    with refused_as("SYN-517") as refused:
        sequence_of(bag, poses=PoseFile(path, "base_link"))
    assert refused.value.code == "SYN-517"
