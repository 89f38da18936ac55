"""The bag, read by rosbags: nothing here uses our own reader."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray
from PIL import Image
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from simulator.faults import DRIFTING_TOPIC, STEPPING_TOPIC
from simulator.options import (
    BESTPOS_TOPIC,
    FAULT_NAMES,
    IMU_TOPIC,
    INSPVAX_TOPIC,
    LIDAR_TOPIC,
    FaultName,
    SimulateOptions,
    topics,
)
from simulator.pipeline import calibration_path, simulate, sweep_stamps_ns
from simulator.recorder import LIDAR_DELAY_NS
from simulator.ros_messages import HESAI_POINT, MAX_DETECTIONS
from simulator.scenery.world import ORIGIN_DEG_M
from simulator.sensors import rig
from simulator.sensors.navigation import FIX_NS, UNDULATION_M
from simulator.truth import read_truth
from stone.geometry.se3 import SE3
from stone_recordings.messages.types.registry import typestore
from tests.simulator.conftest import TINY, Recording


def stamp_of(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def gps_unix_ns(message) -> int:
    head = message.nov_header
    seconds = 315_964_800 + head.gps_week_number * 604_800 - 18
    return seconds * 10**9 + head.gps_week_milliseconds * 10**6


def points_of(cloud) -> NDArray[np.void]:
    return cloud.data.view(HESAI_POINT)


def deskewed_in_map(recording: Recording, cloud) -> NDArray[np.float64]:
    """Every return put into the map by the exact pose at its own timestamp, one at a time."""
    points = points_of(cloud)
    points = points[points["x"] != 0]
    xyz = np.stack([points["x"], points["y"], points["z"]], axis=-1).astype(float)
    stamps = np.round(points["timestamp"] * 1e6).astype(np.int64) * 1000
    poses = recording.truth.trajectory.at(stamps) @ rig.EGO_FROM_LIDAR
    return np.einsum("nij,nj->ni", poses.rotation(), xyz) + poses.translation_m


def test_the_bag_holds_the_whole_rig_in_time_order_as_rosbags_would_write_it(recording: Recording) -> None:
    assert {message.topic: message.kind for message in recording.messages} == topics(TINY)
    for message in recording.messages:
        again = typestore().serialize_cdr(message.value, message.kind)
        assert bytes(again) == message.raw, message.topic
    times = [message.log_time_ns for message in recording.messages]
    assert times == sorted(times)


def test_a_sweep_is_stamped_at_its_first_packet_and_recorded_after_its_last(recording: Recording) -> None:
    sweeps = [message for message in recording.messages if message.topic == "/lidar_points"]
    assert [stamp_of(sweep.value) for sweep in sweeps] == sweep_stamps_ns(TINY)
    for sweep in sweeps:
        times = points_of(sweep.value)["timestamp"]
        assert times[0] == pytest.approx(stamp_of(sweep.value) / 1e9, abs=1e-6)
        assert np.all(np.diff(times) >= 0)
        assert 0.098 < times[-1] - times[0] < 0.1
        assert sweep.log_time_ns == stamp_of(sweep.value) + LIDAR_DELAY_NS


def test_clouds_have_the_hesai_layout(recording: Recording) -> None:
    cloud = recording.of("/lidar_points")[0]
    layout = [(field.name, field.offset, field.datatype) for field in cloud.fields]
    assert layout == list(zip(HESAI_POINT.names, (0, 4, 8, 12, 16, 18), (7, 7, 7, 7, 4, 8), strict=True))
    assert (cloud.point_step, cloud.width, cloud.height) == (26, TINY.channels * TINY.columns, 1)
    points = points_of(cloud)
    assert set(points["ring"]) == set(range(TINY.channels))
    missing = (points["x"] == 0) & (points["y"] == 0) & (points["z"] == 0)
    assert 0 < missing.sum() < len(points)


def test_returns_at_their_own_times_lie_on_the_true_ground_and_at_one_time_do_not(recording: Recording) -> None:
    for cloud in recording.of("/lidar_points"):
        points = deskewed_in_map(recording, cloud)
        above = points[:, 2] - recording.truth.elevation_m(points[:, :2])
        assert np.mean(np.abs(above) < 0.12) > 0.5
        assert np.quantile(above, 0.02) > -0.3
    # The distortion is real: with one pose for the sweep, ground returns fit worse.
    cloud = recording.of("/lidar_points")[2]
    points = points_of(cloud)
    points = points[points["x"] != 0]
    xyz = np.stack([points["x"], points["y"], points["z"]], axis=-1).astype(float)
    rigid = (recording.truth.map_from_ego(stamp_of(cloud)) @ rig.EGO_FROM_LIDAR) @ xyz
    apart = np.linalg.norm(rigid - deskewed_in_map(recording, cloud), axis=-1)
    assert apart.max() > 0.1


def test_receiver_time_is_exact_and_its_header_is_late(recording: Recording) -> None:
    for topic in ("/novatel/oem7/inspvax", "/novatel/oem7/bestpos"):
        messages = recording.of(topic)
        true = np.array([gps_unix_ns(message) for message in messages])
        late = np.array([stamp_of(message) for message in messages]) - true
        assert np.all(np.diff(true) == FIX_NS)
        assert late.min() >= 0
        assert late.max() < 20_000_000
        assert late.std() > 1_000_000
        assert true[0] <= sweep_stamps_ns(TINY)[0]
        assert true[-1] >= sweep_stamps_ns(TINY)[-1] + rig.SWEEP_NS


def test_the_receiver_reports_the_true_pose_of_its_own_place_and_heights_above_the_sea(recording: Recording) -> None:
    for message in recording.of("/novatel/oem7/inspvax"):
        exact = recording.truth.map_from_ego(gps_unix_ns(message)) @ rig.EGO_FROM_INS
        enu = pymap3d.geodetic2enu(message.latitude, message.longitude, message.height, *ORIGIN_DEG_M)
        assert np.linalg.norm(np.array(enu) - exact.translation_m) < 0.08
        ros_rpy_deg = (message.roll, -message.pitch, 90.0 - message.azimuth)
        turn = Rotation.from_euler("xyz", ros_rpy_deg, degrees=True).as_matrix().T @ exact.rotation()
        assert np.rad2deg(Rotation.from_matrix(turn).magnitude()) < 0.2
    pairs = zip(recording.of("/novatel/oem7/bestpos"), recording.of("/novatel/oem7/inspvax"), strict=True)
    for fix, solution in pairs:
        assert fix.hgt + UNDULATION_M == pytest.approx(solution.height, abs=1e-6)
        assert fix.pos_type.type == 50


def test_pictures_are_taken_at_their_phase_and_have_the_calibrated_size(recording: Recording) -> None:
    for camera in rig.cameras():
        pictures = recording.of(camera.topic)
        infos = recording.of(rig.camera_info_topic(camera))
        assert len(pictures) == len(sweep_stamps_ns(TINY))
        for picture, info, sweep_ns in zip(pictures, infos, sweep_stamps_ns(TINY), strict=True):
            assert abs(stamp_of(picture) - sweep_ns - camera.phase_ns) <= 50_000
            image = Image.open(BytesIO(picture.data.tobytes()))
            assert image.size == (info.width, info.height) == (64, 40)
            assert info.k[0] == pytest.approx(rig.intrinsics(64).fx_px)


def test_radar_lists_count_their_valid_slots_of_which_those_ahead_approach(recording: Recording) -> None:
    for channel in rig.RADARS:
        lists = recording.of(rig.radar_topic(channel))
        assert np.all(np.diff([stamp_of(item) for item in lists]) == FIX_NS)
        for item in lists:
            count = item.list_numofdetections
            assert 0 < count < MAX_DETECTIONS
            assert [slot.u_measurementid for slot in item.list_detections[:count]] == list(range(count))
            assert all(slot.f_range >= 1 for slot in item.list_detections[count:])
    item = recording.of("/radar/front/detections")[0]
    ahead = [slot for slot in item.list_detections[: item.list_numofdetections] if abs(slot.f_azimuthangle) < 0.5]
    assert np.median([slot.f_rangerate for slot in ahead]) < -1.0


def test_the_imu_feels_gravity_at_200_hz(recording: Recording) -> None:
    samples = recording.of("/imu/data")
    assert np.all(np.diff([stamp_of(sample) for sample in samples]) == 5_000_000)
    force = np.array([[s.linear_acceleration.x, s.linear_acceleration.y, s.linear_acceleration.z] for s in samples])
    assert np.linalg.norm(force.mean(axis=0)) == pytest.approx(9.81, abs=0.4)
    assert all(sample.orientation_covariance[0] == -1 for sample in samples)


def test_static_transforms_are_the_calibration(recording: Recording) -> None:
    (message,) = recording.of("/tf_static")
    told = {transform.child_frame_id: transform.transform for transform in message.transforms}
    for mount in rig.calibration(64).mounts:
        base_from_sensor: SE3 = rig.EGO_FROM_LIDAR @ mount.lidar_from_sensor
        place, turn = told[mount.frame_id].translation, told[mount.frame_id].rotation
        np.testing.assert_allclose([place.x, place.y, place.z], base_from_sensor.translation_m)
        np.testing.assert_allclose([turn.w, turn.x, turn.y, turn.z], base_from_sensor.wxyz)


def test_equal_options_give_equal_bytes(recording: Recording, tmp_path: Path) -> None:
    simulate(tmp_path / "again.mcap", TINY, tmp_path / "truth")
    assert (tmp_path / "again.mcap").read_bytes() == recording.path.read_bytes()
    assert calibration_path(tmp_path / "again.mcap").read_bytes() == calibration_path(recording.path).read_bytes()


SHORT = SimulateOptions(seconds=0.6, seed=3, channels=4, columns=24, camera_width_px=32, world_width_m=30.0)
RECEIVER = {INSPVAX_TOPIC, BESTPOS_TOPIC}
IMAGES = {camera.channel: {camera.topic, rig.camera_info_topic(camera)} for camera in rig.cameras()}
CHANGED: dict[FaultName, set[str]] = {
    "gnss_jitter": RECEIVER, "clock_18s": RECEIVER, "clock_37s": {LIDAR_TOPIC},
    "camera_late_5ms": IMAGES["CAM_FRONT_LEFT"], "camera_dropped": IMAGES["CAM_FRONT_RIGHT"],
    "radar_drift_50ppm": {DRIFTING_TOPIC}, "imu_lag_12ms": {IMU_TOPIC}, "rtk_gap": RECEIVER,
    "position_jump": RECEIVER, "stamps_back": {STEPPING_TOPIC},
    "cameras_swapped": IMAGES["CAM_FRONT_LEFT"] | IMAGES["CAM_FRONT_RIGHT"], "extrinsic_inverted": set(),
}  # fmt: skip
Messages = Mapping[str, list[tuple[int, bytes]]]


@cache
def read(bag: Path) -> Messages:
    messages: dict[str, list[tuple[int, bytes]]] = {}
    with AnyReader([bag]) as reader:
        for link, log_time_ns, raw in reader.messages():
            messages.setdefault(link.topic, []).append((log_time_ns, bytes(raw)))
    return messages


def values(bag: Path, topic: str) -> list:
    with AnyReader([bag]) as reader:
        links = [link for link in reader.connections if link.topic == topic]
        return [reader.deserialize(raw, link.msgtype) for link, _, raw in reader.messages(links)]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    @cache
    def drive(*faults: FaultName) -> Path:
        bag = tmp_path_factory.mktemp("drive") / "run.mcap"
        simulate(bag, replace(SHORT, faults=faults))
        return bag

    return drive


@pytest.mark.whole
@pytest.mark.parametrize("fault", FAULT_NAMES)
def test_a_fault_changes_what_it_names_and_nothing_else(drive: Callable[..., Path], fault: FaultName) -> None:
    clean, faulty = read(drive()), read(drive(fault))
    assert {topic for topic in clean if faulty.get(topic) != clean[topic]} == CHANGED[fault]
    is_same_rig = calibration_path(drive(fault)).read_bytes() == calibration_path(drive()).read_bytes()
    assert is_same_rig == (fault != "extrinsic_inverted")


@pytest.mark.parametrize("fault", ["clock_18s", "clock_37s", "radar_drift_50ppm", "stamps_back"])
def test_a_clock_that_is_wrong_does_not_change_when_messages_were_recorded(drive, fault):
    clean, faulty = read(drive()), read(drive(fault))
    for topic in CHANGED[fault]:
        assert [time for time, _ in faulty[topic]] == [time for time, _ in clean[topic]]


def test_faults_compose_in_any_order_where_they_touch_different_parts(tmp_path: Path) -> None:
    pair: tuple[FaultName, ...] = ("rtk_gap", "stamps_back")
    for name, faults in (("a", pair), ("b", pair[::-1])):
        simulate(tmp_path / f"{name}.mcap", replace(SHORT, cameras=False, faults=faults))
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_lidar_on_atomic_time_agrees_with_its_stamp_and_swapped_cameras_show_each_other_s(drive):
    for was, cloud in zip(values(drive(), LIDAR_TOPIC), values(drive("clock_37s"), LIDAR_TOPIC), strict=True):
        assert stamp_of(cloud) - stamp_of(was) == 37_000_000_000
        first = cloud.data.view(HESAI_POINT)["timestamp"][0]
        assert first == pytest.approx(stamp_of(cloud) / 1e9, abs=1e-6)
    left, right = (camera.topic for camera in rig.cameras() if camera.channel in ("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"))
    was = {topic: [image.data.tobytes() for image in values(drive(), topic)] for topic in (left, right)}
    now = {topic: values(drive("cameras_swapped"), topic) for topic in (left, right)}
    assert [image.data.tobytes() for image in now[left]] == was[right] != was[left]
    assert {image.header.frame_id for image in now[left]} == {"cam_front_left"}


def test_the_gap_of_the_receiver_lasts_400_ms_and_its_jump_is_25_decimetres_in_float(drive):
    steps = np.diff([gps_unix_ns(message) for message in values(drive("rtk_gap"), INSPVAX_TOPIC)])
    assert sorted(steps)[-2:] == [FIX_NS, 400_000_000]
    was, now = values(drive(), INSPVAX_TOPIC), values(drive("position_jump"), INSPVAX_TOPIC)
    apart = [
        np.linalg.norm(pymap3d.geodetic2enu(b.latitude, b.longitude, b.height, a.latitude, a.longitude, a.height))
        for a, b in zip(was, now, strict=True)
    ]
    is_off = np.array([message.pos_type.type == 55 for message in now])
    assert 0 < is_off.sum() < len(now)
    np.testing.assert_allclose(apart, np.where(is_off, 2.5, 0.0), atol=0.02)
    assert {message.latitude_stdev > 0.4 for message, off in zip(now, is_off, strict=True) if off} == {True}


@pytest.mark.whole
def test_without_noise_the_sensors_tell_the_truth(tmp_path: Path) -> None:
    bag, truth_dir = tmp_path / "exact.mcap", tmp_path / "truth"
    simulate(bag, replace(SHORT, noise_ratio=0.0, cameras=False), truth_dir)
    truth = read_truth(truth_dir)
    for message in values(bag, INSPVAX_TOPIC):
        exact = truth.map_from_ego(gps_unix_ns(message)) @ rig.EGO_FROM_INS
        enu = pymap3d.geodetic2enu(message.latitude, message.longitude, message.height, *ORIGIN_DEG_M)
        np.testing.assert_allclose(enu, exact.translation_m, atol=1e-6)
    for item in values(bag, rig.radar_topic("RADAR_FRONT")):
        assert stamp_of(item) % 1_000_000 == 0
    noisy = tmp_path / "noisy.mcap"
    simulate(noisy, replace(SHORT, cameras=False))
    assert values(noisy, LIDAR_TOPIC)[0].data.tobytes() != values(bag, LIDAR_TOPIC)[0].data.tobytes()


def test_transport_delays_records_and_no_stamp(tmp_path: Path, drive: Callable[..., Path]) -> None:
    simulate(tmp_path / "late.mcap", replace(SHORT, transport_jitter_ns=2_000_000))
    prompt, late = read(drive()), read(tmp_path / "late.mcap")
    for topic, messages in prompt.items():
        assert [raw for _, raw in late[topic]] == [raw for _, raw in messages]
        delays = np.array([late_ns - ns for (late_ns, _), (ns, _) in zip(late[topic], messages, strict=True)])
        assert delays.min() >= 0
        assert delays.max() < 2_000_000
    assert late != prompt
