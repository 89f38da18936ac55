"""What a topic is for is resolved once, by profile, type, rate and names; what cannot be told is said, not guessed."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.sensors import rig
from stone_recordings.topics.profiles import (
    LARGEST_BYTES,
    LONGEST_TOPIC,
    MOST_TOPICS,
    Assignment,
    Candidate,
    TopicProfile,
    channel_of,
    channel_of_words,
    read_profile,
    resolve,
    write_profile,
)
from stone_recordings.topics.roles import INSPVAX, POINT_CLOUD, Role
from testing.refusals import refused_as

IMU, IMAGE, ODOMETRY = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry"
INSPVA = "novatel_oem7_msgs/msg/INSPVA"
LIDAR = Candidate("/lidar_points", POINT_CLOUD, "lidar", 100, 10.0)
INS = Candidate("/novatel/inspvax", INSPVAX, "ins", 200, 20.0)
GYRO = Candidate("/imu/data", IMU, "imu", 2000, 200.0)
FRONT = Candidate("/camera/front/image_raw", IMAGE, "camera", 100, 10.0, "cam_a")
BACK = Candidate("/camera/back/image_raw", IMAGE, "camera", 100, 10.0, "cam_b")
RIG = (LIDAR, INS, GYRO, FRONT, BACK)
PARTS = {"lidar": LIDAR.name, "pose": INS.name, "imu": GYRO.name, "CAM_FRONT": FRONT.name, "CAM_BACK": BACK.name}


def codes(assignment: Assignment) -> list[tuple[str, str]]:
    return [(finding.code, finding.topic) for finding in assignment.findings]


def test_a_plain_rig_is_resolved_without_a_word_and_saved_resolves_the_same() -> None:
    assert resolve(RIG, TopicProfile()) == Assignment(PARTS)
    once = resolve(RIG, TopicProfile())
    assert resolve(RIG, once.as_profile("rover")) == once
    assignment = resolve(RIG, TopicProfile(), {"cam_a": "CAM_BACK", "cam_b": "CAM_FRONT"})
    assert assignment == Assignment(PARTS | {"CAM_BACK": FRONT.name, "CAM_FRONT": BACK.name})


def test_two_lidars_are_an_ambiguity_with_the_line_that_ends_it() -> None:
    second = Candidate("/rear/points", POINT_CLOUD, "lidar", 100, 10.0)
    assignment = resolve((*RIG, second), TopicProfile())
    assert "lidar" not in assignment.channels
    assert codes(assignment) == [("TOP-110", LIDAR.name)]
    sentence = assignment.findings[0].message
    assert "/lidar_points, /rear/points" in sentence
    part, _, topic = sentence.rpartition("--topic ")[2].partition("=")
    assert resolve((*RIG, second), TopicProfile({part: topic})) == Assignment(PARTS)
    assert resolve((*RIG, second), TopicProfile({part: "/rear/points"})).channels == PARTS | {"lidar": "/rear/points"}


def test_the_rate_tells_a_lidar_from_a_map_and_an_imu_from_its_copy() -> None:
    clutter = (
        Candidate("/map", POINT_CLOUD, "lidar", 5, 0.2),
        Candidate("/imu/slow", IMU, "imu", 10, 1.0),
        Candidate("/mystery", POINT_CLOUD, "lidar", 1, None),
    )
    assert resolve((*clutter, *RIG), TopicProfile()) == Assignment(PARTS)


def test_a_second_imu_and_cameras_that_no_name_places_are_only_mentioned() -> None:
    assignment = resolve((*RIG, Candidate("/lidar/imu", IMU, "imu", 1000, 100.0)), TopicProfile())
    assert [(finding.code, finding.severity) for finding in assignment.findings] == [("TOP-110", "info")]
    nameless = Candidate("/image_raw", IMAGE, "camera", 100, 10.0)
    assert codes(resolve((*RIG, nameless), TopicProfile())) == [("TOP-112", "/image_raw")]
    assert resolve((*RIG, nameless), TopicProfile({"CAM_LEFT": "/image_raw"})) == Assignment(
        {"CAM_LEFT": "/image_raw", **PARTS}
    )
    crowd = tuple(Candidate(f"/image{row}", IMAGE, "camera", 100, 10.0) for row in range(1000))
    (finding,) = resolve((*RIG, *crowd), TopicProfile()).findings
    assert finding.code == "TOP-112"
    assert "/image5 and 994 more" in finding.message


def test_poses_come_from_the_ins_and_two_pictures_of_one_camera_are_an_ambiguity() -> None:
    odometry = Candidate("/odom", ODOMETRY, "odometry", 500, 50.0)
    second = Candidate("/novatel/inspva", INSPVA, "ins", 400, 40.0)
    assert resolve((odometry, *RIG), TopicProfile()).channels["pose"] == INS.name
    assert resolve((odometry, second, *RIG), TopicProfile()).channels["pose"] == second.name
    assert resolve((odometry, LIDAR), TopicProfile()).channels["pose"] == odometry.name
    twins = (INS, Candidate("/other/inspvax", INSPVAX, "ins", 200, 20.0), LIDAR)
    assert codes(resolve(twins, TopicProfile())) == [("TOP-110", INS.name)]
    compressed = Candidate("/camera/front/image/compressed", "sensor_msgs/msg/CompressedImage", "camera", 100, 10.0)
    assignment = resolve((*RIG, compressed), TopicProfile())
    assert codes(assignment) == [("TOP-110", FRONT.name)]
    assert "CAM_FRONT" not in assignment.channels
    assert (
        resolve((*RIG, compressed), TopicProfile({"CAM_FRONT": compressed.name})).channels["CAM_FRONT"]
        == compressed.name
    )


@pytest.mark.parametrize("chosen", [{"lidar": "/gone"}, {"lidar": "/imu/data"}])
def test_a_choice_that_the_recording_does_not_bear_out_is_said_and_left(chosen: dict[str, str]) -> None:
    assignment = resolve(RIG, TopicProfile(chosen))
    assert assignment.channels == PARTS
    assert codes(assignment) == [("TOP-111", chosen["lidar"])]


def test_a_cloud_may_be_chosen_against_what_it_was_taken_for() -> None:
    small = Candidate("/tiny_lidar", POINT_CLOUD, "radar", 100, 10.0)
    assert resolve((small, INS), TopicProfile({"lidar": "/tiny_lidar"})) == Assignment(
        {"lidar": "/tiny_lidar", "pose": INS.name}
    )


def test_what_labels_need_and_nobody_recorded_is_named() -> None:
    packets = Candidate("/lidar_packets", "nebula_msgs/msg/NebulaPackets", "other", 10, 10.0)
    assert codes(resolve((), TopicProfile())) == [("TOP-101", ""), ("TOP-103", "")]
    assert codes(resolve((packets, INS), TopicProfile())) == [("TOP-101", "/lidar_packets")]
    silent = Candidate("/lidar_points", POINT_CLOUD, "lidar", 0)
    assert codes(resolve((silent, INS), TopicProfile())) == [("TOP-101", "")]


@given(st.permutations(RIG))
def test_the_order_of_topics_does_not_matter(topics: list[Candidate]) -> None:
    assert resolve(topics, TopicProfile()) == Assignment(PARTS)


@pytest.mark.parametrize(
    "topics",
    [
        {"cam_front": "/a"}, {"CAM": "/a"}, {"lidar": ""}, {"lidar": "/a\n"}, {"lidar": "/" + "a" * LONGEST_TOPIC},
        {"lidar": "/a", "CAM_FRONT": "/a"}, {f"CAM_{row}": f"/{row}" for row in range(MOST_TOPICS + 1)},
    ],
)  # fmt: skip
def test_a_profile_that_cannot_be_is_refused(topics: dict[str, str]) -> None:
    with refused_as("TOP-113"):
        TopicProfile(topics)


ROLES: tuple[Role, ...] = ("lidar", "camera", "radar", "ins", "imu", "odometry", "tf", "other")
ANY = st.builds(
    Candidate,
    name=st.sampled_from(["front", "left", "rear/left", "odd", "\x00", "x" * 400]).flatmap(
        lambda word: st.integers(0, 5).map(lambda number: f"/{word}/{number}")
    ),
    type=st.sampled_from([POINT_CLOUD, IMAGE, IMU, INSPVA, INSPVAX, "std_msgs/msg/String"]),
    role=st.sampled_from(ROLES),
    count=st.integers(0, 3),
    rate_hz=st.none() | st.floats(0.0, 1e6),
    frame_id=st.sampled_from(["", "a", "/a", "cam_front"]),
)
CHOSEN = st.dictionaries(st.sampled_from(["lidar", "pose", "imu", "CAM_FRONT"]), st.sampled_from(["/odd/1", "/left/2"]))


@pytest.mark.whole
@given(
    st.lists(ANY, unique_by=lambda candidate: candidate.name, max_size=12),
    CHOSEN.filter(lambda topics: len(set(topics.values())) == len(topics)),
)
def test_whatever_was_recorded_each_topic_plays_one_part_at_most(topics, chosen):
    assignment = resolve(topics, TopicProfile(chosen), {"a": "CAM_BACK"})
    played = list(assignment.channels.values())
    assert len(set(played)) == len(played)
    assert set(played) <= {topic.name for topic in topics if topic.count}
    refused = {finding.topic for finding in assignment.findings if finding.code == "TOP-111"}
    for part, topic in chosen.items():
        assert (assignment.channels.get(part) == topic) or topic in refused


def test_a_profile_is_read_as_it_was_written(tmp_path: Path) -> None:
    profile = TopicProfile({"lidar": "/punkte: ü #1", "CAM_FRONT": "yes", "pose": "~"}, "rover 'x'")
    write_profile(tmp_path / "rover.yaml", profile)
    assert read_profile(tmp_path / "rover.yaml") == profile
    write_profile(tmp_path / "rover.yaml", TopicProfile())
    assert read_profile(tmp_path / "rover.yaml") == TopicProfile()


HEAD = b"stone_profile: 1\n"


@pytest.mark.parametrize(
    "content",
    [
        b"", b"- a", b"stone_profile: 2\ntopics: {}", b"\xff\xfe\x00", HEAD, HEAD + b"topics: {lidar: 3}",
        HEAD + b"topics: []", HEAD + b"topics: {}\nplattform: x", HEAD + b"topics: {}\nplatform: 3",
        HEAD + b"topics: &a {lidar: *a}", HEAD + b"topics: !!python/object:os.system {}", HEAD + b"#" * LARGEST_BYTES,
    ],
)  # fmt: skip
def test_what_is_no_profile_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "rover.yaml").write_bytes(content)
    with refused_as("TOP-114"):
        read_profile(tmp_path / "rover.yaml")


def test_a_part_there_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rover.yaml").write_bytes(HEAD + b"topics: {lidarr: /points}")
    with refused_as("TOP-113"):
        read_profile(tmp_path / "rover.yaml")


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("/camera/front/image_raw", "CAM_FRONT"), ("/camera/front_left/image/compressed", "CAM_FRONT_LEFT"),
        ("/left/front_camera", "CAM_FRONT_LEFT"), ("/cameras/rearRight/image", "CAM_BACK_RIGHT"),
        ("/sensing/camera/camera_rear_optical", "CAM_BACK"), ("cam_fl", "CAM_FRONT_LEFT"),
        ("CAM_BACK_LEFT", "CAM_BACK_LEFT"), ("/cam/frontleft/image", "CAM_FRONT_LEFT"),
        ("/zed/left/image_rect_color", "CAM_LEFT"), ("/camera0/image_raw", None), ("/bright/backlight", None),
        ("/camera/left_to_right/image", None), ("", None),
    ],
)  # fmt: skip
def test_words_of_a_name_say_where_a_camera_looks(name: str, channel: str | None) -> None:
    assert channel_of_words("camera", name) == channel


def test_a_frame_that_the_calibration_knows_decides_and_else_topic_then_frame() -> None:
    frames = {"cam3_optical": "CAM_BACK"}
    assert channel_of("camera", "/camera/front/image", "cam3_optical", frames) == "CAM_BACK"
    assert channel_of("camera", "/camera/front/image", "/cam3_optical", frames) == "CAM_BACK"
    assert channel_of("camera", "/camera/front/image", "cam4_optical", frames) == "CAM_FRONT"
    assert channel_of("radar", "/radar/points", "mast", {"mast": "CAM_BACK"}) is None
    assert channel_of("radar", "/ars548/detections", "radar_left", {}) == "RADAR_LEFT"
    assert channel_of("radar", "/radar/right", "radar_left", {}) == "RADAR_RIGHT"
    for camera in rig.cameras():
        assert channel_of("camera", camera.topic, "", {}) == camera.channel
        assert channel_of("camera", "/image", camera.frame_id, {}) == camera.channel
    for channel in rig.RADARS:
        assert channel_of("radar", rig.radar_topic(channel), "", {}) == channel


@given(st.text(max_size=60))
def test_any_text_names_a_channel_or_none(name: str) -> None:
    channel = channel_of_words("camera", name)
    assert channel is None or set(channel.split("_")) <= {"CAM", "FRONT", "BACK", "LEFT", "RIGHT"}


@pytest.mark.parametrize(
    ("name", "type_name", "way_out"),
    [
        ("/ouster/lidar_packets", "ouster_sensor_msgs/msg/PacketMsg", "/ouster/points"),
        ("/os_node/lidar_packets", "ouster_ros/msg/PacketMsg", "/ouster/points"),
        ("/rslidar_packets", "rslidar_msg/msg/RslidarPacket", "/rslidar_points"),
        ("/top/robosense_packets", "robosense_msgs/msg/RobosenseScan", "/robosense_points"),
        ("/hesai/pandar", "hesai_lidar/msg/PandarScan", "/lidar_points"),
        ("/scan", "sensor_msgs/msg/LaserScan", "one plane"),
        ("/echoes", "sensor_msgs/msg/MultiEchoLaserScan", "one plane"),
        ("/cloud", "sensor_msgs/msg/PointCloud", "convert"),
        ("/seyond", "seyond/msg/SeyondScan", "PointCloud2"),
        ("/livox/lidar_raw", "livox_sdk_msgs/msg/LivoxPacket", "xfer_format"),
        ("/draco", "foxglove_msgs/msg/CompressedPointCloud", "PointCloud2"),
    ],
)
def test_points_that_are_not_read_are_named_by_topic_and_type(name: str, type_name: str, way_out: str) -> None:
    unread = Candidate(name, type_name, "other", 100, 10.0)
    (missing,) = resolve((unread, INS), TopicProfile()).findings
    assert (missing.code, missing.severity, missing.topic) == ("TOP-101", "error", name)
    (beside,) = resolve((*RIG, unread), TopicProfile()).findings
    assert (beside.code, beside.severity, beside.topic) == ("TOP-120", "info", name)
    for finding in (missing, beside):
        assert all(word in finding.message for word in (name, type_name, way_out))


@pytest.mark.parametrize(
    ("name", "type_name"),
    [
        ("/ouster/imu_packets", "ouster_sensor_msgs/msg/PacketMsg"),
        ("/gnss/packets", "ublox_msgs/msg/RawPacket"),
        ("/radar/packets", "radar_driver_msgs/msg/RadarPacket"),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ("/markers", "visualization_msgs/msg/MarkerArray"),
    ],
)
def test_what_holds_no_points_is_not_named(name: str, type_name: str) -> None:
    assert resolve((*RIG, Candidate(name, type_name, "other", 100, 10.0)), TopicProfile()).findings == ()


@pytest.mark.parametrize(
    "type_name",
    [
        "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
        "foxglove_msgs/msg/CompressedVideo",
        "theora_image_transport/msg/Packet",
    ],
)
def test_video_is_named_with_a_way_out(type_name: str) -> None:
    video = Candidate("/cam_front/ffmpeg", type_name, "other", 100, 10.0)
    (finding,) = resolve((*RIG, video), TopicProfile()).findings
    assert (finding.code, finding.severity, finding.topic) == ("TOP-121", "warning", "/cam_front/ffmpeg")
    assert type_name in finding.message
    assert "republish" in finding.message
