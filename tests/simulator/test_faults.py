"""Each fault changes what it names, and nothing else; without noise the sensors tell the truth."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from rosbags.highlevel import AnyReader

from simulator.faults import DRIFTING_TOPIC, FAULTS, STEPPING_TOPIC, all_of
from simulator.options import FAULT_NAMES, FaultName, SimulateOptions, SimulationOptionError
from simulator.pipeline import calibration_path, simulate
from simulator.ros_messages import HESAI_POINT
from simulator.scenery.world import ORIGIN_DEG_M
from simulator.sensors import rig
from simulator.sensors.navigation import FIX_NS
from simulator.topics import BESTPOS_TOPIC, IMU_TOPIC, INSPVAX_TOPIC, LIDAR_TOPIC
from simulator.truth import read_truth
from tests.simulator.test_recording import gps_unix_ns, stamp_of

SHORT = SimulateOptions(seconds=0.6, seed=3, channels=4, columns=24, camera_width_px=32, world_width_m=30.0)
RECEIVER = {INSPVAX_TOPIC, BESTPOS_TOPIC}
IMAGES = {camera.channel: {camera.topic, rig.camera_info_topic(camera)} for camera in rig.cameras()}
CHANGED: dict[FaultName, set[str]] = {
    "gnss_jitter": RECEIVER,
    "clock_18s": RECEIVER,
    "clock_37s": {LIDAR_TOPIC},
    "camera_late_5ms": IMAGES["CAM_FRONT_LEFT"],
    "camera_dropped": IMAGES["CAM_FRONT_RIGHT"],
    "radar_drift_50ppm": {DRIFTING_TOPIC},
    "imu_lag_12ms": {IMU_TOPIC},
    "rtk_gap": RECEIVER,
    "position_jump": RECEIVER,
    "stamps_back": {STEPPING_TOPIC},
    "cameras_swapped": IMAGES["CAM_FRONT_LEFT"] | IMAGES["CAM_FRONT_RIGHT"],
    "extrinsic_inverted": set(),
}
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


def test_every_name_is_a_fault() -> None:
    assert set(FAULTS) == set(FAULT_NAMES) == set(CHANGED)


@pytest.mark.parametrize("fault", FAULT_NAMES)
def test_a_fault_changes_what_it_names_and_nothing_else(drive: Callable[..., Path], fault: FaultName) -> None:
    clean, faulty = read(drive()), read(drive(fault))
    assert {topic for topic in clean if faulty.get(topic) != clean[topic]} == CHANGED[fault]
    is_same_rig = calibration_path(drive(fault)).read_bytes() == calibration_path(drive()).read_bytes()
    assert is_same_rig == (fault != "extrinsic_inverted")


@pytest.mark.parametrize("fault", ["clock_18s", "clock_37s", "radar_drift_50ppm", "stamps_back"])
def test_a_clock_that_is_wrong_does_not_change_when_messages_were_recorded(
    drive: Callable[..., Path], fault: FaultName
) -> None:
    clean, faulty = read(drive()), read(drive(fault))
    for topic in CHANGED[fault]:
        assert [time for time, _ in faulty[topic]] == [time for time, _ in clean[topic]]


def test_faults_compose_in_any_order_where_they_touch_different_parts(tmp_path: Path) -> None:
    pair: tuple[FaultName, ...] = ("rtk_gap", "stamps_back")
    for name, faults in (("a", pair), ("b", pair[::-1])):
        simulate(tmp_path / f"{name}.mcap", replace(SHORT, cameras=False, faults=faults))
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_the_points_of_a_lidar_on_atomic_time_agree_with_its_stamp(drive: Callable[..., Path]) -> None:
    for was, cloud in zip(values(drive(), LIDAR_TOPIC), values(drive("clock_37s"), LIDAR_TOPIC), strict=True):
        assert stamp_of(cloud) - stamp_of(was) == 37_000_000_000
        first = cloud.data.view(HESAI_POINT)["timestamp"][0]
        assert first == pytest.approx(stamp_of(cloud) / 1e9, abs=1e-6)


def test_the_gap_of_the_receiver_lasts_400_ms(drive: Callable[..., Path]) -> None:
    steps = np.diff([gps_unix_ns(message) for message in values(drive("rtk_gap"), INSPVAX_TOPIC)])
    assert sorted(steps)[-2:] == [FIX_NS, 400_000_000]


def test_the_jump_is_25_decimetres_and_the_receiver_knows_it_floats(drive: Callable[..., Path]) -> None:
    was, now = values(drive(), INSPVAX_TOPIC), values(drive("position_jump"), INSPVAX_TOPIC)
    apart = [
        np.linalg.norm(pymap3d.geodetic2enu(b.latitude, b.longitude, b.height, a.latitude, a.longitude, a.height))
        for a, b in zip(was, now, strict=True)
    ]
    is_off = np.array([message.pos_type.type == 55 for message in now])
    assert 0 < is_off.sum() < len(now)
    np.testing.assert_allclose(apart, np.where(is_off, 2.5, 0.0), atol=0.02)
    assert {message.latitude_stdev > 0.4 for message, off in zip(now, is_off, strict=True) if off} == {True}


def test_swapped_cameras_show_each_other_s_pictures(drive: Callable[..., Path]) -> None:
    left, right = (camera.topic for camera in rig.cameras() if camera.channel in ("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"))
    was = {topic: [image.data.tobytes() for image in values(drive(), topic)] for topic in (left, right)}
    now = {topic: values(drive("cameras_swapped"), topic) for topic in (left, right)}
    assert [image.data.tobytes() for image in now[left]] == was[right] != was[left]
    assert {image.header.frame_id for image in now[left]} == {"cam_front_left"}


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


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("faults", ("rtk_gap", "bad_luck")),
        ("noise_ratio", -1.0),
        ("noise_ratio", float("nan")),
        ("transport_jitter_ns", 5_000_000),
        ("host_delay_max_ns", -1),
    ],
)
def test_what_cannot_go_wrong_is_refused(name: str, value: object) -> None:
    with pytest.raises(SimulationOptionError, match=f"{name} is "):
        SimulateOptions(**{name: value})


def test_no_fault_leaves_all_as_it_is() -> None:
    rigged = rig.calibration(64)
    assert all_of(()).calibration(rigged) is rigged
