"""The bag, read by rosbags: nothing here uses our own reader."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate, sweep_stamps_ns
from simulator.recorder import LIDAR_DELAY_NS
from simulator.ros_messages import HESAI_POINT, MAX_DETECTIONS
from simulator.scenery.world import ORIGIN_DEG_M
from simulator.sensors import rig
from simulator.sensors.navigation import FIX_NS, UNDULATION_M
from simulator.topics import topics
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


def test_the_bag_holds_the_whole_rig(recording: Recording) -> None:
    assert {message.topic: message.kind for message in recording.messages} == topics(TINY)


def test_rosbags_writes_every_message_back_to_the_same_bytes(recording: Recording) -> None:
    for message in recording.messages:
        again = typestore().serialize_cdr(message.value, message.kind)
        assert bytes(again) == message.raw, message.topic


def test_messages_are_recorded_in_time_order(recording: Recording) -> None:
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
    assert layout == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("intensity", 12, 7),
        ("ring", 16, 4),
        ("timestamp", 18, 8),
    ]
    assert (cloud.point_step, cloud.width, cloud.height) == (26, TINY.channels * TINY.columns, 1)
    points = points_of(cloud)
    assert set(points["ring"]) == set(range(TINY.channels))
    missing = (points["x"] == 0) & (points["y"] == 0) & (points["z"] == 0)
    assert 0 < missing.sum() < len(points)


def test_returns_at_their_own_times_lie_on_the_true_ground(recording: Recording) -> None:
    for cloud in recording.of("/lidar_points"):
        points = deskewed_in_map(recording, cloud)
        above = points[:, 2] - recording.truth.elevation_m(points[:, :2])
        assert np.mean(np.abs(above) < 0.12) > 0.5
        assert np.quantile(above, 0.02) > -0.3


def test_leaving_out_the_motion_moves_the_ground(recording: Recording) -> None:
    """The distortion is real: with one pose for the sweep, ground returns fit worse."""
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


def test_the_receiver_reports_the_true_pose_of_its_own_place(recording: Recording) -> None:
    for message in recording.of("/novatel/oem7/inspvax"):
        exact = recording.truth.map_from_ego(gps_unix_ns(message)) @ rig.EGO_FROM_INS
        enu = pymap3d.geodetic2enu(message.latitude, message.longitude, message.height, *ORIGIN_DEG_M)
        assert np.linalg.norm(np.array(enu) - exact.translation_m) < 0.08
        ros_rpy_deg = (message.roll, -message.pitch, 90.0 - message.azimuth)
        turn = Rotation.from_euler("xyz", ros_rpy_deg, degrees=True).as_matrix().T @ exact.rotation()
        assert np.rad2deg(Rotation.from_matrix(turn).magnitude()) < 0.2


def test_bestpos_heights_are_above_the_sea(recording: Recording) -> None:
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


def test_radar_lists_count_their_valid_slots_and_leave_the_rest_stale(recording: Recording) -> None:
    for channel in rig.RADARS:
        lists = recording.of(rig.radar_topic(channel))
        assert np.all(np.diff([stamp_of(item) for item in lists]) == FIX_NS)
        for item in lists:
            count = item.list_numofdetections
            assert 0 < count < MAX_DETECTIONS
            assert [slot.u_measurementid for slot in item.list_detections[:count]] == list(range(count))
            assert all(slot.f_range >= 1 for slot in item.list_detections[count:])


def test_what_stands_ahead_of_the_front_radar_approaches(recording: Recording) -> None:
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


def test_another_seed_gives_another_world(recording: Recording, tmp_path: Path) -> None:
    other = SimulateOptions(
        seconds=0.2, seed=4, channels=4, columns=24, cameras=False, world_width_m=60.0, compression="zstd"
    )
    simulate(tmp_path / "other.mcap", other)
    assert (tmp_path / "other.mcap").stat().st_size < recording.path.stat().st_size
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.calibration.yaml", "other.mcap"]
