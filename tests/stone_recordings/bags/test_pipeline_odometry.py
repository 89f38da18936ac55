"""Odometry and TF recordings: which pose source is taken, over which mounts, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone_files.bag_fingerprint import recording_sha256
from stone_recordings.bags.errors import CloudLayoutError, NotABagError
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.poses.extrinsics import static_tree
from stone_recordings.poses.sources import RigMounts, track_from_odometry
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.errors import (
    AmbiguousTopicsError,
    NoLidarError,
    NoPosedFramesError,
    NoPoseSourceError,
    NoUsablePoseError,
    WrongTopicError,
)
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import LIDAR_FRAME, ODOM_TOPIC, PERIOD_NS, T0_NS, calibration, plain_sweep, written

STAMPS_NS = T0_NS + np.arange(8) * PERIOD_NS
TRUTH = rigs.world_from_ego(STAMPS_NS)


def sweeps(stamps_ns=STAMPS_NS):
    return [plain_sweep(int(stamp)) for stamp in stamps_ns]


def odometry(poses: SE3 = TRUTH, **facts):
    return [rigs.odometry(int(stamp), poses[i], **facts) for i, stamp in enumerate(STAMPS_NS)]


def synchronised(path: Path, cal: Calibration | None = None, **options):
    return synchronise(path, cal or calibration(), SynchroniseOptions(**options), "run")


def codes(sequence) -> set[str]:
    """Random points show no ground, which CAL-435 says."""
    return {finding.code for finding in sequence.findings} - {"CAL-435"}


def assert_true_path(sequence, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(sequence.frames.map_from_ego.as_matrix(), TRUTH.as_matrix(), atol=atol)


def test_the_base_link_of_odometry_is_the_ego_frame(tmp_path):
    sequence, source = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry()))
    assert_true_path(sequence)
    assert sequence.pose_source == "/odom (odom to base_link, nav_msgs/msg/Odometry)"
    assert sequence.map_origin_deg_m is None
    assert codes(sequence) == {"TOP-102"}
    assert source.sweep(3).points_lidar.shape == (1200, 3)


def test_odometry_of_the_lidar_is_carried_to_the_ego_frame(tmp_path):
    of_lidar = TRUTH @ rigs.EGO_FROM_LIDAR
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(of_lidar, child=LIDAR_FRAME)))
    assert_true_path(sequence)


def test_odometry_of_another_sensor_is_carried_over_its_mount(tmp_path):
    of_imu = TRUTH @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[3].lidar_from_sensor
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(of_imu, child="imu_link")))
    assert_true_path(sequence)


def test_a_frame_that_nobody_knows_is_taken_for_the_ego_frame_and_said(tmp_path):
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(child="chassis")))
    assert_true_path(sequence)
    assert "CAL-405" in codes(sequence)


@pytest.mark.parametrize(
    ("parent", "child", "sensor"),
    [
        ("camera_init", "body", "IMU"),
        ("/camera_init", "/aft_mapped", "IMU or LiDAR"),
        ("odom", "imu_sensor", "IMU"),
        ("map", "velodyne_top", "LiDAR"),
        ("odom", "zed2_left_camera_frame", "camera"),
        ("odom", "gps_antenna", "receiver"),
    ],
)
def test_a_sensor_that_nobody_places_is_named_with_what_to_add(tmp_path, parent, child, sensor):
    poses = odometry(parent=parent, child=child)
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), poses))
    finding = next(f for f in sequence.findings if f.code == "CAL-405")
    assert (finding.severity, finding.topic) == ("warning", child)
    assert f"it is the {sensor}'s" in finding.message
    assert f"frame_id {child}" in finding.message


@pytest.mark.parametrize(("parent", "child"), [("odom", "body"), ("camera_init", "base_link"), ("map", "base")])
def test_the_base_of_a_robot_is_not_taken_for_a_sensor(tmp_path, parent, child):
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(parent=parent, child=child)))
    assert "CAL-405" not in codes(sequence)


def test_an_imu_under_camera_init_that_the_calibration_places_is_carried_over_its_mount(tmp_path):
    """FAST-LIO's `body`, entered as the frame of the IMU's mount."""
    rig = calibration()
    mounts = tuple(replace(mount, frame_id="body") if mount.kind == "imu" else mount for mount in rig.mounts)
    of_imu = TRUTH @ rigs.EGO_FROM_LIDAR @ rigs.MOUNTS[3].lidar_from_sensor
    bag = written(tmp_path / "a.mcap", sweeps(), odometry(of_imu, parent="camera_init", child="body"))
    sequence, _ = synchronise(bag, replace(rig, mounts=mounts), SynchroniseOptions(), "run")
    assert_true_path(sequence)
    assert "CAL-405" not in codes(sequence)


def test_tf_static_that_agrees_is_silent(tmp_path):
    static = [rigs.transform("/tf_static", T0_NS, "base_link", LIDAR_FRAME, rigs.EGO_FROM_LIDAR)]
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(), static))
    assert_true_path(sequence)
    assert codes(sequence) == {"TOP-102"}


def test_tf_static_that_disagrees_is_a_warning_and_the_path_of_the_lidar_stays(tmp_path):
    """2 cm and 1° off: the calibration says where the ego frame is, the recording where the LiDAR went."""
    base_from_lidar = rigs.placed([0.0, 0.0, np.deg2rad(1)], [0.0, 0.0, 0.02]) @ rigs.EGO_FROM_LIDAR
    static = [rigs.transform("/tf_static", T0_NS, "base_link", LIDAR_FRAME, base_from_lidar)]
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(), static))
    finding = next(f for f in sequence.findings if f.code == "CAL-414")
    assert (finding.severity, finding.topic) == ("warning", "ego_from_lidar")
    assert "1.00°" in finding.message
    map_from_lidar = sequence.frames.map_from_ego @ rigs.EGO_FROM_LIDAR
    np.testing.assert_allclose(map_from_lidar.as_matrix(), (TRUTH @ base_from_lidar).as_matrix(), atol=1e-9)


def test_tf_static_is_followed_along_the_tree(tmp_path):
    middle = rigs.placed([0.1, 0.2, 0.3], [1.0, 2.0, 3.0])
    static = [
        rigs.transform("/tf_static", T0_NS, "base_link", "mast", middle),
        rigs.transform("/tf_static", T0_NS + 1, "mast", LIDAR_FRAME, middle.inverse() @ rigs.EGO_FROM_LIDAR),
        rigs.transform("/tf_static", T0_NS + 2, LIDAR_FRAME, "radar", rigs.placed([0, 0, 0], [0.0, 0.6, 0])),
    ]
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), odometry(), static))
    assert_true_path(sequence)
    assert [f.topic for f in sequence.findings if f.code == "CAL-414"] == ["RADAR_LEFT"]


def test_tf_is_taken_when_there_is_nothing_better(tmp_path):
    moving = [rigs.transform("/tf", int(s), "odom", "base_link", TRUTH[i]) for i, s in enumerate(STAMPS_NS)]
    moving += [rigs.transform("/tf", int(s), "base_link", "wheel", SE3.identity()) for s in STAMPS_NS]
    sequence, _ = synchronised(written(tmp_path / "a.mcap", sweeps(), moving))
    assert_true_path(sequence)
    assert sequence.pose_source == "/tf (odom to base_link, tf2_msgs/msg/TFMessage)"


@pytest.mark.parametrize("source", ["odometry", "tf"])
def test_messages_without_a_pose_cost_themselves_alone_and_are_named(tmp_path, source):
    nowhere = SE3(TRUTH.wxyz_xyz.copy())
    nowhere.wxyz_xyz[3, 4] = np.nan
    nowhere.wxyz_xyz[5, :4] = 0.0
    moving = [rigs.transform("/tf", int(s), "odom", "base_link", nowhere[i]) for i, s in enumerate(STAMPS_NS)]
    path = written(tmp_path / "a.mcap", sweeps(), odometry(nowhere) if source == "odometry" else moving)
    sequence, _ = synchronised(path)
    assert len(sequence.frames) == 8
    finding = next(finding for finding in sequence.findings if finding.code == "MSG-305")
    assert str(STAMPS_NS[3]) in finding.message
    assert str(STAMPS_NS[5]) in finding.message
    assert "2 messages hold no pose" in finding.message
    told = [one for one in inspect(path).findings if one.code == "MSG-305"]
    assert told == ([finding] if source == "odometry" else [])


LATE_NS = 18 * 10**9


def test_a_lidar_on_another_clock_is_put_right_by_the_calibration_or_the_command(tmp_path):
    late = [plain_sweep(int(stamp) + LATE_NS) for stamp in STAMPS_NS]
    path = written(tmp_path / "a.mcap", late, odometry())
    with pytest.raises(NoPosedFramesError, match=r"\+18\.000 s apart at the start"):
        synchronised(path)
    lidar = Mount("LIDAR_TOP", "lidar", SE3.identity(), LIDAR_FRAME, -LATE_NS)
    known = replace(calibration(), mounts=(*calibration().mounts, lidar))
    for cal, options in ((known, {}), (calibration(), {"time_offsets_ns": {"lidar": -LATE_NS}})):
        sequence, source = synchronised(path, cal, **options)
        assert_true_path(sequence)
        assert sequence.frames.stamps_ns.tolist() == STAMPS_NS.tolist()
        assert source.sweep(3).stamp_ns == STAMPS_NS[3]
        assert "TIM-214" in codes(sequence)


def test_poses_on_another_clock_are_put_right_by_the_calibration_or_the_command(tmp_path):
    stamps_ns = STAMPS_NS + LATE_NS
    late = [rigs.odometry(int(stamp), TRUTH[i], child="imu_link") for i, stamp in enumerate(stamps_ns)]
    path = written(tmp_path / "a.mcap", sweeps(), late)
    mounts = tuple(
        replace(mount, time_offset_ns=-LATE_NS) if mount.frame_id == "imu_link" else mount
        for mount in calibration().mounts
    )
    for cal, options in (
        (replace(calibration(), mounts=mounts), {}),
        (calibration(), {"time_offsets_ns": {"pose": -LATE_NS}}),
    ):
        sequence, _ = synchronised(path, cal, **options)
        assert len(sequence.frames) == 8
        assert "TIM-214" in codes(sequence)


def test_the_topic_asked_for_wins(tmp_path):
    other = odometry(TRUTH @ rigs.placed([0, 0, 0], [5.0, 0, 0]), topic="/wheel")
    path = written(tmp_path / "a.mcap", sweeps(), odometry(), other)
    with pytest.raises(AmbiguousTopicsError, match="2 topics fit the role odometry: /odom, /wheel; choose one with"):
        synchronised(path)
    sequence, _ = synchronised(path, odometry_topic=ODOM_TOPIC)
    assert_true_path(sequence)
    for asked, found in (("/nothing", "has no messages"), (rigs.LIDAR_TOPIC, "is of type sensor_msgs/msg/PointCloud2")):
        with pytest.raises(WrongTopicError, match=found):
            synchronised(path, odometry_topic=asked)


def test_a_recording_without_poses_is_refused_with_what_it_has(tmp_path):
    with pytest.raises(NoPoseSourceError, match=r"found: /lidar_points \(sensor_msgs/msg/PointCloud2\)"):
        synchronised(written(tmp_path / "a.mcap", sweeps()))
    wheel = [rigs.transform("/tf", T0_NS, "base_link", "wheel", SE3.identity())]
    with pytest.raises(NoPoseSourceError, match="found: /tf base_link to wheel"):
        synchronised(written(tmp_path / "b.mcap", sweeps(), wheel))


def test_a_recording_without_lidar_is_refused(tmp_path):
    with pytest.raises(NoLidarError, match="no LiDAR sensor_msgs/msg/PointCloud2"):
        synchronised(written(tmp_path / "a.mcap", odometry()))
    two = [plain_sweep(int(s)) for s in STAMPS_NS]
    second = [type(m)("/lidar_rear", m.type, m.log_time_ns, m.payload) for m in two]
    path = written(tmp_path / "b.mcap", two, second, odometry())
    with pytest.raises(AmbiguousTopicsError, match="role lidar: /lidar_points, /lidar_rear"):
        synchronised(path)
    assert len(synchronised(path, lidar_topic="/lidar_rear")[0].frames) == 8


def test_a_pose_source_of_other_days_is_refused(tmp_path):
    with pytest.raises(NoPosedFramesError, match="8 no_pose_after_last"):
        synchronised(written(tmp_path / "a.mcap", sweeps(STAMPS_NS + 3_600_000_000_000), odometry()))


def test_stamps_that_go_back_or_repeat_are_sorted_out_and_said(tmp_path):
    order = [0, 1, 3, 2, 4, 5, 5, 6, 7]
    shuffled = [
        type(m)(m.topic, m.type, int(T0_NS + place * PERIOD_NS), m.payload)
        for place, m in enumerate(plain_sweep(int(STAMPS_NS[i])) for i in order)
    ]
    backwards = [
        type(m)(m.topic, m.type, int(T0_NS + place * PERIOD_NS), m.payload)
        for place, m in enumerate(reversed(odometry()))
    ]
    sequence, source = synchronised(written(tmp_path / "a.mcap", shuffled, backwards))
    assert sequence.frames.stamps_ns.tolist() == STAMPS_NS.tolist()
    assert_true_path(sequence)
    assert {"TIM-203", "TIM-206"} <= codes(sequence)
    assert source.message_index.tolist() == [0, 1, 3, 2, 4, 5, 7, 8]


def test_an_empty_sweep_is_excluded(tmp_path):
    some = sweeps()
    some[2] = plain_sweep(int(STAMPS_NS[2]), count=0)
    sequence, _ = synchronised(written(tmp_path / "a.mcap", some, odometry()))
    assert [(e.code, e.stamp_ns) for e in sequence.excluded] == [("empty_sweep", STAMPS_NS[2])]
    only = [plain_sweep(int(s), count=0) for s in STAMPS_NS]
    with pytest.raises(NoPosedFramesError, match="8 empty_sweep"):
        synchronised(written(tmp_path / "b.mcap", only, odometry()), lidar_topic=rigs.LIDAR_TOPIC)


def test_hostile_files_are_refused(tmp_path):
    page = tmp_path / "page.mcap"
    page.write_text("<html><body>404</body></html>")
    with pytest.raises(NotABagError, match=r"page\.mcap is not an MCAP"):
        synchronised(page)
    lying = [plain_sweep(int(s), point_step=3) for s in STAMPS_NS]
    with pytest.raises(CloudLayoutError, match="point_step"):
        synchronised(written(tmp_path / "lies.mcap", lying, odometry()))
    one = sweeps()
    one[6] = plain_sweep(int(STAMPS_NS[6]), point_step=3)
    sequence, source = synchronised(written(tmp_path / "late.mcap", one, odometry()))
    assert [source.sweep(frame).stamp_ns for frame in range(7)] == [*STAMPS_NS[:6].tolist(), int(STAMPS_NS[7])]
    assert [(frame.stamp_ns, frame.code) for frame in sequence.excluded] == [(STAMPS_NS[6], "malformed_sweep")]
    assert "point_step" in sequence.excluded[0].reason
    assert {"MSG-303", "SYN-501"} <= codes(sequence)


def test_a_pose_topic_without_a_message_is_refused():
    rig = RigMounts(calibration(), static_tree(()), LIDAR_FRAME)
    with pytest.raises(NoUsablePoseError, match="none of its 0 samples is usable"):
        track_from_odometry([], ODOM_TOPIC, rig)


def test_the_hash_of_a_folder_is_of_names_and_contents(tmp_path):
    (tmp_path / "a.db3").write_bytes(b"1")
    before = recording_sha256(tmp_path)
    (tmp_path / "b.db3").write_bytes(b"2")
    assert recording_sha256(tmp_path) != before


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
