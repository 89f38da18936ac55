"""Which messages of the other sensors belong to a frame, by channel, phase and nearness."""

from pathlib import Path

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.geometry.se3 import SE3
from stone_recordings.poses.extrinsics import StaticTree, turn_deg
from stone_recordings.sync.association import mount_of
from stone_recordings.sync.errors import WrongTopicError
from stone_recordings.sync.recorded_messages import in_order
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, calibration, plain_sweep, stamped, written

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


def synchronised(path: Path, *groups):
    return synchronise(written(path, *groups), calibration(), SynchroniseOptions(), "run")[0]


def test_every_sensor_is_found_under_its_channel(tmp_path, base):
    radar_ns = T0_NS - 7_000_000 + np.arange(42) * 50_000_000
    imu_ns = T0_NS - 1_000_000 + np.arange(420) * 5_000_000
    sequence = synchronised(
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
    assert [f.code for f in sequence.findings if f.topic == RADAR] == ["SYN-504"]


def test_an_imu_keeps_its_samples_from_frame_to_frame(tmp_path, base):
    """Recorded out of order and twice: they are counted in the order of their stamps."""
    imu_ns = T0_NS - 1_000_000 + np.arange(420) * 5_000_000
    recorded = messages(IMU, "sensor_msgs/msg/Imu", [*imu_ns[:50], imu_ns[20], *imu_ns[50:]], "imu_link")
    frames = synchronised(tmp_path / "a.mcap", base, recorded).frames
    start = frames.slices["IMU"].start
    assert (len(start), frames.slices["IMU"].topic) == (len(frames) + 1, IMU)
    for index, stamp_ns in enumerate(frames.stamps_ns):
        between = imu_ns[start[index] : start[index + 1]]
        expected = [s for s in imu_ns if stamp_ns <= s < stamp_ns + PERIOD_NS]
        assert between.tolist() == expected


def test_an_imu_that_is_silent_has_empty_slices(tmp_path, base):
    sequence = synchronised(tmp_path / "a.mcap", base, messages(IMU, "sensor_msgs/msg/Imu", STAMPS_NS[:1], "imu_link"))
    assert sequence.frames.slices["IMU"].start.tolist() == [0] + [1] * 20


def test_the_phase_that_was_learnt_is_kept_with_the_images_and_reaches_the_labeler(tmp_path, base):
    imu = messages(IMU, "sensor_msgs/msg/Imu", STAMPS_NS, "imu_link")
    sequence = synchronised(tmp_path / "a.mcap", base, images(STAMPS_NS + PHASE_NS), imu)
    read = read_sequence(sequence_bytes(sequence)).frames
    assert read.associations["CAM_FRONT"].phase_ns == PHASE_NS
    assert read.associations["IMU"].phase_ns is None
    assert read.slices["IMU"].start.tolist() == sequence.frames.slices["IMU"].start.tolist()


def test_a_topic_named_for_a_channel_is_that_channels(tmp_path, base):
    """The profile of a platform says so, whatever frame the messages are in."""
    stamps_ns = STAMPS_NS + 1_000_000
    unknown = messages("/other/image", "sensor_msgs/msg/CompressedImage", stamps_ns, "elsewhere")
    path = written(tmp_path / "a.mcap", base, unknown)
    for channel, expected in (("CAM_FRONT", "CAM_FRONT"), ("RADAR_LEFT", "/other/image")):
        options = SynchroniseOptions(topics={channel: "/other/image"})
        assert list(synchronise(path, calibration(), options, "run")[0].frames.associations) == [expected]
    with pytest.raises(WrongTopicError, match="/other/image"):
        synchronise(path, calibration(), SynchroniseOptions(topics={"lidar": "/other/image"}), "run")
    with pytest.raises(WrongTopicError, match="/other/image"):
        synchronise(path, calibration(), SynchroniseOptions(topics={"pose": "/other/image"}), "run")


def test_an_image_belongs_to_the_frame_that_triggered_it_not_to_the_nearest(tmp_path, base):
    """At a phase of 60 ms the nearest stamp would be the next frame's."""
    sequence = synchronised(tmp_path / "a.mcap", base, images(np.delete(STAMPS_NS + PHASE_NS, 7)))
    index = sequence.frames.associations["CAM_FRONT"].message_index
    assert index.tolist() == [*range(7), -1, *range(7, 19)]


def test_a_camera_that_fires_off_its_phase_is_said(tmp_path, base):
    late_ns = STAMPS_NS + PHASE_NS
    late_ns[5] += 9_000_000
    sequence = synchronised(tmp_path / "a.mcap", base, images(late_ns))
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
    sequence = synchronised(tmp_path / "a.mcap", base, swapped)
    assert sequence.frames.associations["IMU"].message_index[:3].tolist() == [0, 3, 4]
    assert "TIM-203" in [f.code for f in sequence.findings if f.topic == IMU]


def test_a_sensor_the_calibration_does_not_know_goes_by_its_topic(tmp_path, base):
    stamps_ns = STAMPS_NS + 1_000_000
    unknown = messages("/other/image", "sensor_msgs/msg/CompressedImage", stamps_ns, "elsewhere")
    sequence = synchronised(tmp_path / "a.mcap", base, unknown)
    assert list(sequence.frames.associations) == ["/other/image"]


def test_a_channel_spelt_out_in_the_topic_is_enough():
    assert mount_of("/sensors/radar_left/list", "unheard_of", "radar", calibration()).name == "RADAR_LEFT"
    assert mount_of("/sensors/radar_left/list", "unheard_of", "camera", calibration()) is None
    assert mount_of("/anything", "/cam_front", "camera", calibration()).name == "CAM_FRONT"
    assert mount_of("/frontCamera/image_raw", "unheard_of", "camera", calibration()).name == "CAM_FRONT"
    assert mount_of("/camera/rear/image_raw", "unheard_of", "camera", calibration()) is None


def test_order_keeps_the_first_of_equal_stamps_and_counts_steps_back():
    ordered = in_order("/t", np.array([10, 30, 20, 20, 40], np.int64) * 1_000_000)
    assert ordered.index.tolist() == [0, 2, 1, 4]
    assert ordered.stamps_ns.tolist() == [10_000_000, 20_000_000, 30_000_000, 40_000_000]
    assert [f.code for f in ordered.findings] == ["TIM-203", "TIM-206"]
    assert "worst -10.000 ms" in ordered.findings[0].message
    assert in_order("/t", np.array([], np.int64)).findings == ()


def test_unconnected_frames_and_loops_end_the_search():
    step = SE3.identity()
    loop = StaticTree({("a", "b"): step, ("b", "a"): step, ("b", "c"): step, ("c", "a"): step, ("c", "b"): step})
    assert loop.transform("a", "c") is not None
    assert loop.transform("a", "z") is None


@pytest.mark.parametrize("angle_deg", [0.0, 0.2, 90.0, 179.0])
def test_the_turn_of_a_transform_is_its_angle_whatever_the_sign(angle_deg):
    turned = rigs.placed([0.0, 0.0, np.deg2rad(angle_deg)], [1, 2, 3])
    assert turn_deg(turned) == pytest.approx(angle_deg, abs=1e-9)
    assert turn_deg(SE3(turned.wxyz_xyz * [-1, -1, -1, -1, 1, 1, 1])) == pytest.approx(angle_deg, abs=1e-9)
