"""A NovAtel recording gives back its path, lever arm, GPS time and deskewed sweeps; every sensor its own messages."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.geometry.se3 import SE3
from stone.sensors.calibration_errors import MissingSensorError
from stone.sensors.sequence import frame_token
from stone_recordings.poses.extrinsics import StaticTree, turn_deg
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.association import mount_of
from stone_recordings.sync.errors import NoUsablePoseError
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from testing.refusals import refused_as
from tests.stone_recordings import rigs
from tests.stone_recordings.messages.lidars.encoding import SentPacket, nebula_packets, velodyne_scan
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, calibration, ins_messages, plain_sweep, stamped, written
from tests.stone_recordings.writing import Recorded

SWEEPS_NS = T0_NS + 20_300_000 + np.arange(12) * PERIOD_NS
POSES_NS = T0_NS + np.arange(-2, 30) * 50_000_000


def synchronised(path: Path, cal=None, **options):
    return synchronise(path, cal or calibration(), SynchroniseOptions(**options), "run")


def expected_map_from_ego(stamps_ns, origin):
    """The true path, seen from the map's own origin."""
    east_north_up = np.array(pymap3d.geodetic2enu(*origin, *rigs.ORIGIN))
    truth = rigs.world_from_ego(stamps_ns)
    return truth.rotation(), truth.translation_m - east_north_up, east_north_up


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sweeps = [rigs.wall_sweep(int(stamp)) for stamp in SWEEPS_NS]
    return written(tmp_path_factory.mktemp("ins") / "drive.mcap", sweeps, ins_messages(POSES_NS))


@pytest.fixture(scope="module")
def result(drive):
    return synchronised(drive)


def test_poses_are_the_true_ones_within_two_millimetres_and_the_lever_arm_turns_with_the_robot(result):
    sequence, _ = result
    frames = sequence.frames
    assert frames.stamps_ns.tolist() == SWEEPS_NS.tolist()
    assert sequence.excluded == ()
    rotation, place_m, _ = expected_map_from_ego(frames.stamps_ns, sequence.map_origin_deg_m)
    np.testing.assert_allclose(frames.map_from_ego.translation_m, place_m, atol=1.5e-3)
    np.testing.assert_allclose(frames.map_from_ego.rotation(), rotation, atol=2e-4)
    # The lever arm is a metre: not turned with the robot, it would miss by far more than the tolerance.
    lever = (rigs.EGO_FROM_LIDAR @ rigs.LIDAR_FROM_INS).translation_m
    assert np.linalg.norm(rotation @ lever - lever, axis=1).min() > 0.1


def test_the_map_begins_at_the_first_solution_by_gps_time_and_frames_are_named(result):
    sequence, _ = result
    first = rigs.world_from_ego(POSES_NS[:1]) @ rigs.EGO_FROM_LIDAR @ rigs.LIDAR_FROM_INS
    oracle = pymap3d.enu2geodetic(*first.translation_m[0], *rigs.ORIGIN)
    np.testing.assert_allclose(sequence.map_origin_deg_m, oracle, atol=1e-9)
    assert sequence.pose_source == "/novatel/oem7/inspvax (novatel_oem7_msgs/msg/INSPVAX)"
    assert [finding.code for finding in sequence.findings] == ["TIM-201", "CAL-435"]  # its sweeps show no ground
    assert sequence.frames.tokens[3] == frame_token("run", int(SWEEPS_NS[3]))
    assert len(sequence.inputs["drive.mcap"]) == 64


def test_deskewed_sweeps_lie_on_the_wall_and_raw_ones_do_not(result):
    sequence, sweeps = result
    raw = replace(sweeps, mount=None)
    _, _, shift_m = expected_map_from_ego(SWEEPS_NS, sequence.map_origin_deg_m)
    map_from_lidar = sequence.frames.map_from_ego @ rigs.EGO_FROM_LIDAR
    copy = pickle.loads(pickle.dumps(sweeps))
    worst_raw_m = 0.0
    for index in range(len(SWEEPS_NS)):
        sweep = copy.sweep(index)
        assert (sweep.stamp_ns, sweep.points_lidar.shape) == (SWEEPS_NS[index], (400, 3))
        wall = map_from_lidar[index] @ sweep.points_lidar.astype(np.float64) + shift_m
        np.testing.assert_allclose(wall[:, 1], rigs.WALL_Y_M, atol=6e-3)
        bent = map_from_lidar[index] @ raw.sweep(index).points_lidar.astype(np.float64) + shift_m
        worst_raw_m = max(worst_raw_m, float(np.abs(bent[:, 1] - rigs.WALL_Y_M).max()))
    assert worst_raw_m > 0.3


def test_sweeps_without_a_pose_are_excluded_each_with_its_reason(tmp_path):
    poses_ns = np.delete(POSES_NS, np.arange(12, 18))[4:20]
    path = written(tmp_path / "a.mcap", [rigs.wall_sweep(int(s)) for s in SWEEPS_NS], ins_messages(poses_ns))
    sequence, sweeps = synchronised(path)
    reasons = {int((e.stamp_ns - SWEEPS_NS[0]) // PERIOD_NS): (e.code, e.reason) for e in sequence.excluded}
    assert reasons[0] == ("no_pose_before_first", "the stamp lies before the first pose")
    assert reasons[4] == ("pose_gap", "the sweep's last point lies in a gap of 350.0 ms between two poses")
    assert reasons[5][0] == "pose_gap"
    assert reasons[11] == ("no_pose_after_last", "the sweep's last point lies after the last pose")
    assert len(sequence.frames) + len(reasons) == len(SWEEPS_NS)
    assert "SYN-501" in [finding.code for finding in sequence.findings]
    assert all(len(sweeps.sweep(i).points_lidar) == 400 for i in range(len(sequence.frames)))
    bridged, _ = synchronised(path, max_pose_gap_ns=350_000_000)
    assert "pose_gap" not in {e.code for e in bridged.excluded}


def test_a_recording_on_two_clocks_is_refused_with_their_distance(tmp_path):
    late = [rigs.wall_sweep(int(stamp)) for stamp in SWEEPS_NS + 37_000_000_000]
    path = written(tmp_path / "a.mcap", late, ins_messages(POSES_NS))
    with refused_as("SYN-501", match=r"12 no_pose_after_last.*\+37\.120 s apart at the start"):
        synchronised(path)


def test_an_ins_that_never_aligned_is_refused(tmp_path):
    path = written(tmp_path / "a.mcap", [rigs.wall_sweep(int(SWEEPS_NS[0]))], ins_messages(POSES_NS, ins_status=1))
    with pytest.raises(NoUsablePoseError, match="32 without an aligned solution"):
        synchronised(path)


def test_samples_without_a_solution_and_rtk_that_was_not_fixed_are_said(tmp_path):
    unaligned = ins_messages(POSES_NS[:4], ins_status=1)
    path = written(
        tmp_path / "a.mcap", [rigs.wall_sweep(int(s)) for s in SWEEPS_NS], unaligned + ins_messages(POSES_NS[4:])
    )
    sequence, _ = synchronised(path)
    assert "4 of 32 samples had no solution" in " ".join(f.message for f in sequence.findings)
    assert sequence.excluded[0].code == "no_pose_before_first"
    path = written(
        tmp_path / "b.mcap", [rigs.wall_sweep(int(s)) for s in SWEEPS_NS], ins_messages(POSES_NS, pos_type=55)
    )
    sequence, _ = synchronised(path)
    assert "RTK was fixed only 0.0 % of the time (100.0 % float)" in [f.message for f in sequence.findings]


def test_an_ins_without_a_mount_is_refused_and_its_clock_offset_moves_the_poses(drive):
    without = replace(calibration(), mounts=rigs.MOUNTS[1:])
    with pytest.raises(MissingSensorError):
        synchronised(drive, without)
    ins = replace(rigs.MOUNTS[0], time_offset_ns=-10_000_000)
    sequence, _ = synchronised(drive, calibration(ins))
    _, place_m, _ = expected_map_from_ego(sequence.frames.stamps_ns + 10_000_000, sequence.map_origin_deg_m)
    np.testing.assert_allclose(sequence.frames.map_from_ego.translation_m, place_m, atol=2e-3)


STAMPS_NS = T0_NS + np.arange(20) * PERIOD_NS
CAMERA, RADAR, IMU = "/cam/compressed", "/radar/detections", "/imu/data"
PHASE_NS = 60_000_000


def messages(topic, type_name, stamps_ns, frame_id):
    return [stamped(topic, type_name, int(stamp), frame_id) for stamp in stamps_ns]


def images(stamps_ns):
    return messages(CAMERA, "sensor_msgs/msg/CompressedImage", stamps_ns, "cam_front")


@pytest.fixture(scope="module")
def base():
    poses = rigs.world_from_ego(STAMPS_NS)
    odometry = [rigs.odometry(int(stamp), poses[i]) for i, stamp in enumerate(STAMPS_NS)]
    return [*[plain_sweep(int(stamp)) for stamp in STAMPS_NS], *odometry]


def associated(path: Path, *groups):
    return synchronise(written(path, *groups), calibration(), SynchroniseOptions(), "run")[0]


@pytest.mark.whole
def test_every_sensor_is_found_under_its_channel(tmp_path, base):
    radar_ns = T0_NS - 7_000_000 + np.arange(42) * 50_000_000
    imu_ns = T0_NS - 1_000_000 + np.arange(420) * 5_000_000
    sequence = associated(
        tmp_path / "a.mcap",
        base,
        images(STAMPS_NS + PHASE_NS),
        messages(RADAR, "ars548_messages/msg/DetectionList", radar_ns[:24], "/radar"),
        messages(IMU, "sensor_msgs/msg/Imu", imu_ns, "imu_link"),
    )
    found = sequence.frames.associations
    assert set(found) == {"CAM_FRONT", "RADAR_LEFT", "IMU"}
    assert {key: value.topic for key, value in found.items()} == {"CAM_FRONT": CAMERA, "RADAR_LEFT": RADAR, "IMU": IMU}
    assert found["CAM_FRONT"].message_index.tolist() == list(range(20))
    assert set(found["CAM_FRONT"].dt_ns.tolist()) == {PHASE_NS}
    assert found["RADAR_LEFT"].message_index[:12].tolist() == list(range(0, 24, 2))
    assert (found["RADAR_LEFT"].message_index[12:] == -1).all()
    assert set(found["RADAR_LEFT"].dt_ns[:12].tolist()) == {-7_000_000}
    assert (found["RADAR_LEFT"].dt_ns[12:] == 0).all()
    assert found["IMU"].message_index.tolist() == list(range(0, 400, 20))
    # What the random lists hold, no radar measures.
    assert {f.code for f in sequence.findings if f.topic == RADAR} - {"MSG-301"} == {"SYN-504"}


def test_an_imu_keeps_its_samples_from_frame_to_frame(tmp_path, base):
    """Recorded out of order and twice: they are counted in the order of their stamps."""
    imu_ns = T0_NS - 1_000_000 + np.arange(420) * 5_000_000
    recorded = messages(IMU, "sensor_msgs/msg/Imu", [*imu_ns[:50], imu_ns[20], *imu_ns[50:]], "imu_link")
    frames = associated(tmp_path / "a.mcap", base, recorded).frames
    start = frames.slices["IMU"].start
    assert (len(start), frames.slices["IMU"].topic) == (len(frames) + 1, IMU)
    for index, stamp_ns in enumerate(frames.stamps_ns):
        between = imu_ns[start[index] : start[index + 1]]
        expected = [s for s in imu_ns if stamp_ns <= s < stamp_ns + PERIOD_NS]
        assert between.tolist() == expected


def test_an_imu_that_is_silent_has_empty_slices(tmp_path, base):
    sequence = associated(tmp_path / "a.mcap", base, messages(IMU, "sensor_msgs/msg/Imu", STAMPS_NS[:1], "imu_link"))
    assert sequence.frames.slices["IMU"].start.tolist() == [0] + [1] * 20


def test_the_phase_that_was_learnt_is_kept_with_the_images_and_reaches_the_labeler(tmp_path, base):
    imu = messages(IMU, "sensor_msgs/msg/Imu", STAMPS_NS, "imu_link")
    sequence = associated(tmp_path / "a.mcap", base, images(STAMPS_NS + PHASE_NS), imu)
    read = read_sequence(sequence_bytes(sequence)).frames
    assert read.associations["CAM_FRONT"].phase_ns == PHASE_NS
    assert read.associations["IMU"].phase_ns is None
    assert read.slices["IMU"].start.tolist() == sequence.frames.slices["IMU"].start.tolist()


def test_a_topic_named_for_a_channel_is_that_channels_and_an_unknown_sensor_goes_by_its_topic(tmp_path, base):
    """The profile of a platform says so, whatever frame the messages are in."""
    stamps_ns = STAMPS_NS + 1_000_000
    unknown = messages("/other/image", "sensor_msgs/msg/CompressedImage", stamps_ns, "elsewhere")
    path = written(tmp_path / "a.mcap", base, unknown)
    for channel, expected in (("CAM_FRONT", "CAM_FRONT"), ("RADAR_LEFT", "/other/image")):
        options = SynchroniseOptions(topics={channel: "/other/image"})
        assert list(synchronise(path, calibration(), options, "run")[0].frames.associations) == [expected]
    with refused_as("TOP-104"):
        synchronise(path, calibration(), SynchroniseOptions(topics={"lidar": "/other/image"}), "run")
    with refused_as("TOP-104"):
        synchronise(path, calibration(), SynchroniseOptions(topics={"pose": "/other/image"}), "run")
    sequence = associated(tmp_path / "a.mcap", base, unknown)
    assert list(sequence.frames.associations) == ["/other/image"]


def test_an_image_belongs_to_the_frame_that_triggered_it_not_to_the_nearest(tmp_path, base):
    """At a phase of 60 ms the nearest stamp would be the next frame's."""
    sequence = associated(tmp_path / "a.mcap", base, images(np.delete(STAMPS_NS + PHASE_NS, 7)))
    index = sequence.frames.associations["CAM_FRONT"].message_index
    assert index.tolist() == [*range(7), -1, *range(7, 19)]


def test_a_camera_that_fires_off_its_phase_is_said(tmp_path, base):
    late_ns = STAMPS_NS + PHASE_NS
    late_ns[5] += 9_000_000
    sequence = associated(tmp_path / "a.mcap", base, images(late_ns))
    finding = next(f for f in sequence.findings if f.code == "TIM-205")
    assert finding.topic == CAMERA
    assert "phase of 60.00 ms in 5.0 % of the frames (worst 9.00 ms)" in finding.message
    assert sequence.frames.associations["CAM_FRONT"].dt_ns[5] == 69_000_000


def test_messages_recorded_out_of_order_are_found_at_their_own_index(tmp_path, base):
    imu_ns = T0_NS + np.arange(40) * 50_000_000
    swapped = messages(IMU, "sensor_msgs/msg/Imu", imu_ns, "imu_link")
    swapped[2], swapped[3] = (
        type(swapped[2])(IMU, swapped[2].type, swapped[2].log_time_ns, swapped[3].payload),
        type(swapped[3])(IMU, swapped[3].type, swapped[3].log_time_ns, swapped[2].payload),
    )
    sequence = associated(tmp_path / "a.mcap", base, swapped)
    assert sequence.frames.associations["IMU"].message_index[:3].tolist() == [0, 3, 4]
    assert "TIM-203" in [f.code for f in sequence.findings if f.topic == IMU]


def test_a_channel_is_found_by_its_words_and_a_search_of_frames_ends():
    assert mount_of("/sensors/radar_left/list", "unheard_of", "radar", calibration()).name == "RADAR_LEFT"
    assert mount_of("/sensors/radar_left/list", "unheard_of", "camera", calibration()) is None
    assert mount_of("/anything", "/cam_front", "camera", calibration()).name == "CAM_FRONT"
    assert mount_of("/frontCamera/image_raw", "unheard_of", "camera", calibration()).name == "CAM_FRONT"
    assert mount_of("/camera/rear/image_raw", "unheard_of", "camera", calibration()) is None
    step = SE3.identity()
    loop = StaticTree({("a", "b"): step, ("b", "a"): step, ("b", "c"): step, ("c", "a"): step, ("c", "b"): step})
    assert loop.transform("a", "c") is not None
    assert loop.transform("a", "z") is None


@pytest.mark.parametrize("angle_deg", [0.0, 0.2, 90.0, 179.0])
def test_the_turn_of_a_transform_is_its_angle_whatever_the_sign(angle_deg):
    turned = rigs.placed([0.0, 0.0, np.deg2rad(angle_deg)], [1, 2, 3])
    assert turn_deg(turned) == pytest.approx(angle_deg, abs=1e-9)
    assert turn_deg(SE3(turned.wxyz_xyz * [-1, -1, -1, -1, 1, 1, 1])) == pytest.approx(angle_deg, abs=1e-9)


PACKETS_NS = T0_NS + np.arange(8) * PERIOD_NS
SCAN, NEBULA = "velodyne_msgs/msg/VelodyneScan", "nebula_msgs/msg/NebulaPackets"


def scan(stamp_ns: int, packets: int = 75) -> Recorded:
    """A turn of a VLP-16 in a round room of 10 m."""
    sent = [
        SentPacket("VLP-16", 1327 * number, [(480 * number + 40 * block) % 36_000 for block in range(12)],
                   np.full((12, 32), 5000)).content
        for number in range(packets)
    ]  # fmt: skip
    stamps_ns = [stamp_ns + 1_327_000 * number for number in range(packets)]
    return Recorded("/velodyne_packets", SCAN, stamp_ns + PERIOD_NS, velodyne_scan(sent, stamps_ns, stamp_ns))


def scans() -> list[Recorded]:
    return [scan(int(stamp)) for stamp in PACKETS_NS]


def odometry() -> list[Recorded]:
    stamps_ns = T0_NS + np.arange(-1, 19) * PERIOD_NS // 2
    return [rigs.odometry(int(stamp), rigs.world_from_ego(np.array([stamp]))[0]) for stamp in stamps_ns]


def codes(path: Path) -> list[tuple[str, str]]:
    return [(one.code, one.topic) for one in inspect(path).findings if not one.code.startswith("TIM-")]


def test_packets_are_a_lidar_and_are_said_to_be_packets(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", scans(), odometry())
    assert codes(path) == [("TOP-116", "/velodyne_packets")]
    inspection = inspect(path)
    assert inspection.assignment.channels["lidar"] == "/velodyne_packets"
    sequence, sweeps = synchronise(path, calibration(), SynchroniseOptions(), "run")
    assert len(sequence.frames) == 8
    assert "TOP-116" in {finding.code for finding in sequence.findings}
    assert "TOP-102" not in {finding.code for finding in sequence.findings}
    ranges_m = np.linalg.norm(sweeps.sweep(3).points_lidar, axis=1)
    assert len(ranges_m) == 75 * 12 * 32
    assert np.abs(ranges_m - 10.0).max() < 0.6  # the robot moves on at 4.8 m/s while the room is measured


def test_points_come_before_packets_unless_packets_are_asked_for(tmp_path: Path) -> None:
    clouds = [plain_sweep(int(stamp)) for stamp in PACKETS_NS]
    path = written(tmp_path / "a.mcap", scans(), clouds, odometry())
    assert inspect(path).assignment.channels["lidar"] == "/lidar_points"
    assert synchronise(path, calibration(), SynchroniseOptions(), "run")[1].topic == "/lidar_points"
    asked = SynchroniseOptions(lidar_topic="/velodyne_packets")
    assert synchronise(path, calibration(), asked, "run")[1].topic == "/velodyne_packets"


def test_a_message_whose_packets_are_of_something_else_costs_itself(tmp_path: Path) -> None:
    some = scans()
    at_ns = int(PACKETS_NS[2])
    strange = velodyne_scan([b"\xff\xee" + bytes(1203) + b"\x21"], [at_ns], at_ns)
    some[2] = Recorded("/velodyne_packets", SCAN, some[2].log_time_ns, strange)
    empty_ns = int(PACKETS_NS[5])
    some[5] = Recorded("/velodyne_packets", SCAN, some[5].log_time_ns, velodyne_scan([], [], empty_ns))
    path = written(tmp_path / "a.mcap", some, odometry())
    sequence, _ = synchronise(path, calibration(), SynchroniseOptions(), "run")
    assert [(one.stamp_ns, one.code) for one in sequence.excluded] == [
        (at_ns, "malformed_sweep"),
        (empty_ns, "empty_sweep"),
    ]
    assert "HDL-32E" in sequence.excluded[0].reason
    assert ("MSG-312", "/velodyne_packets") in codes(path)


def test_packets_that_are_not_decoded_are_refused_with_the_topic_to_record(tmp_path: Path) -> None:
    content = b"\xee\xff\x06\x01" + bytes(560)
    raw = [nebula_packets([content], [int(stamp)], int(stamp)) for stamp in PACKETS_NS]
    messages = [Recorded("/pandar", NEBULA, int(at), payload) for at, payload in zip(PACKETS_NS, raw, strict=True)]
    path = written(tmp_path / "a.mcap", messages, odometry())
    assert codes(path) == [("MSG-313", "/pandar"), ("TOP-101", "/pandar")]
    with refused_as("TOP-101"):
        synchronise(path, calibration(), SynchroniseOptions(), "run")
    kind = "ouster_sensor_msgs/msg/PacketMsg"
    raw = [Recorded("/ouster/lidar_packets", kind, int(at), b"\0\1\0\0" + bytes(64)) for at in PACKETS_NS]
    path = written(tmp_path / "a.mcap", raw, odometry())
    assert codes(path) == [("TOP-101", "/ouster/lidar_packets")]
    with refused_as("TOP-101"):
        synchronise(path, calibration(), SynchroniseOptions(), "run")
