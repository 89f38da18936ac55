"""Cameras are judged by where the LiDAR looked when they fired: late, swapped, or following nothing."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.findings import Finding
from stone.geometry.se3 import SE3, wxyz_from_rotation
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.sequence import Association, Frames, Sequence, frame_token
from stone_recordings.bags.bag import open_bag
from stone_recordings.clocks.triggers import bearing_rad, trigger_findings
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.sweeps import BagSweeps
from tests.stone.sensors.test_gyro_lag import Drive
from tests.stone_recordings import writing
from tests.stone_recordings.clocks.streams import IMU, MS, every, sentence, solutions, timing_codes
from tests.stone_recordings.rigs import ODOM_TOPIC, T0_NS, odometry, plain_sweep, written

PERIOD_NS = 100 * MS
STAMPS_NS = every(PERIOD_NS, 12)
# The LiDAR turns clockwise from 170°; cameras every 60°, seen from above.
START_DEG = 170.0
BEARINGS_DEG = {"CAM_FRONT": 90.0, "CAM_FRONT_LEFT": 150.0, "CAM_BACK_LEFT": -150.0, "CAM_BACK": -90.0}


def _camera(name: str, bearing_deg: float) -> Mount:
    """Optical: z along the bearing, x to its right, y down."""
    bearing = np.deg2rad(bearing_deg)
    forward, down = np.array([np.cos(bearing), np.sin(bearing), 0.0]), np.array([0.0, 0.0, -1.0])
    rotation = np.stack([np.cross(down, forward), down, forward], axis=-1)
    return Mount(name, "camera", SE3.from_parts(wxyz_from_rotation(rotation), np.array([0.1, 0.0, -0.1])))


def _phase_ns(name: str) -> int:
    """When the LiDAR looks along this camera's bearing."""
    return round((START_DEG - BEARINGS_DEG[name]) % 360 / 360 * PERIOD_NS)


def _bag(path: Path, record: np.dtype[np.void] = writing.HESAI) -> Path:
    count = 1800
    azimuth = np.deg2rad(START_DEG) - 2 * np.pi * np.arange(count) / count
    points = np.zeros(count, record)
    points["x"], points["y"], points["z"] = 9 * np.cos(azimuth), 9 * np.sin(azimuth), -1.0
    messages = []
    for stamp_ns in STAMPS_NS.tolist():
        if "timestamp" in (record.names or ()):
            points["timestamp"] = (stamp_ns + np.arange(count) * (PERIOD_NS // count)) * 1e-9
        payload = writing.cloud_payload(points, writing.CloudText(stamp_ns=stamp_ns))
        messages.append(writing.Recorded("/lidar", writing.POINT_CLOUD, stamp_ns + PERIOD_NS, payload))
    return writing.write_mcap(path, messages)


def _found(path: Path, fired_ns: Mapping[str, int]) -> tuple[Finding, ...]:
    """What is said of a sequence whose cameras fire so long after each stamp; −1 is a frame without an image."""
    frames = len(STAMPS_NS)
    index = np.where(np.arange(frames) == 3, -1, np.arange(frames))
    associations = {
        name: Association(f"/{name.lower()}/image", index, np.where(index < 0, 0, np.full(frames, late_ns)))
        for name, late_ns in fired_ns.items()
    }
    tokens = tuple(frame_token("run", stamp_ns) for stamp_ns in STAMPS_NS.tolist())
    mounts = tuple(_camera(name, bearing_deg) for name, bearing_deg in BEARINGS_DEG.items())
    sequence = Sequence(
        name="run",
        frames=Frames(STAMPS_NS, tokens, SE3.identity((frames,)), associations),
        excluded=(),
        calibration=Calibration("rig", SE3.identity(), mounts),
        pose_source="none",
    )
    with open_bag(path) as bag:
        return trigger_findings(bag, sequence, BagSweeps(path, "/lidar", np.arange(frames), STAMPS_NS, None))


def _on_time() -> dict[str, int]:
    return {name: _phase_ns(name) for name in BEARINGS_DEG}


def test_cameras_on_time_have_no_findings_and_those_that_all_fire_at_once_follow_nothing(tmp_path: Path) -> None:
    for name, bearing_deg in BEARINGS_DEG.items():
        assert np.rad2deg(bearing_rad(_camera(name, bearing_deg))) == pytest.approx(bearing_deg)
    bag = _bag(tmp_path / "run.mcap")
    assert _found(bag, _on_time()) == ()
    jittered = {name: phase_ns + (row - 2) * 800_000 for row, (name, phase_ns) in enumerate(_on_time().items())}
    assert _found(bag, jittered) == ()
    assert _found(_bag(tmp_path / "run.mcap"), dict.fromkeys(BEARINGS_DEG, 33 * MS)) == ()


def test_the_late_one_swapped_ones_and_what_all_share_are_named(tmp_path: Path) -> None:
    fired_ns = _on_time() | {"CAM_BACK": _phase_ns("CAM_BACK") + 5 * MS}
    (found,) = _found(_bag(tmp_path / "run.mcap"), fired_ns)
    assert (found.code, found.topic) == ("TIM-205", "/cam_back/image")
    assert "Fires 5.0" in found.message
    assert "(18° of its turn; limit 2 ms)" in found.message
    left, right = "CAM_FRONT_LEFT", "CAM_BACK"
    found = _found(_bag(tmp_path / "run.mcap"), _on_time() | {left: _phase_ns(right), right: _phase_ns(left)})
    assert {(one.code, one.topic) for one in found} == {("CAL-406", f"/{name.lower()}/image") for name in (left, right)}
    assert f"where the calibration puts {right}, not {left}" in found[0].message
    fired_ns = {name: phase_ns + 7 * MS for name, phase_ns in _on_time().items()}
    (found,) = _found(_bag(tmp_path / "run.mcap"), fired_ns)
    assert (found.code, found.topic) == ("TIM-205", "/lidar")
    assert "7.0" in found.message


def test_nothing_is_said_without_times_of_points_or_with_one_camera(tmp_path: Path) -> None:
    late = _on_time() | {"CAM_BACK": _phase_ns("CAM_BACK") + 5 * MS}
    assert _found(_bag(tmp_path / "untimed.mcap", writing.KITTI), late) == ()
    timed = _bag(tmp_path / "timed.mcap")
    assert _found(timed, {"CAM_BACK": late["CAM_BACK"]}) == ()
    assert _found(timed, {}) == ()


SECONDS = 8
INS_TOPIC = "/ins"
DRIVE = Drive(3, seconds=float(SECONDS))
# How the IMU is bolted on: on its side, looking backwards.
BODY_FROM_IMU = Rotation.from_euler("ZYX", [2.9, 0.1, 1.5])
POSES_NS = T0_NS + np.arange(SECONDS * 20, dtype=np.int64) * 50 * MS
POSES_S = (POSES_NS - T0_NS).astype(np.float64) * 1e-9
SWEEPS = [plain_sweep(T0_NS + row * 100 * MS) for row in range(SECONDS * 10)]


def _readings(lag_ns: int) -> list[writing.Recorded]:
    """200 Hz of the drive's body rates, stamped `lag_ns` late."""
    stamps_ns, rates = DRIVE.gyro(lag_ns * 1e-9)
    stamps_ns = stamps_ns - int(DRIVE.source()[0][0]) + T0_NS
    message = writing.random_message(IMU, np.random.default_rng(1), is_tame=True)
    recorded = []
    for stamp_ns, rate in zip(stamps_ns.tolist(), rates @ BODY_FROM_IMU.as_matrix(), strict=True):
        message.header = writing.header(stamp_ns, "imu_link")
        velocity = message.angular_velocity
        velocity.x, velocity.y, velocity.z = rate
        recorded.append(writing.Recorded("/imu", IMU, stamp_ns + MS, writing.serialised(message)))
    return recorded


def _solutions() -> list[writing.Recorded]:
    """The receiver's attitude at whole milliseconds, stamped by a host that is 1 to 5 ms late."""
    angles_deg = np.rad2deg(DRIVE.angles(POSES_S))
    late_ns = np.random.default_rng(0).integers(MS, 5 * MS, len(POSES_NS))
    attitudes = [{"azimuth": 90 - yaw, "pitch": -pitch, "roll": roll} for yaw, pitch, roll in angles_deg.tolist()]
    return solutions(INS_TOPIC, POSES_NS, late_ns, attitudes)


def _odometry() -> list[writing.Recorded]:
    """The pose of the same body by odometry."""
    wxyz = np.roll(DRIVE.attitude(POSES_S).as_quat(), 1, axis=1)
    poses = [SE3.from_parts(quaternion, np.zeros(3)) for quaternion in wxyz]
    return [odometry(stamp_ns, pose, child="gps") for stamp_ns, pose in zip(POSES_NS.tolist(), poses, strict=True)]


@pytest.mark.parametrize("lag_ns", [0, -40 * MS])
def test_the_lag_against_an_ins_is_that_at_gps_time(tmp_path: Path, lag_ns: int) -> None:
    """Its host stamps are 1 to 5 ms late, unevenly; they do not count."""
    inspection = inspect(written(tmp_path / "run.mcap", SWEEPS, _solutions(), _readings(lag_ns)))
    lag = inspection.clocks.imu_lag
    assert lag is not None
    assert (lag.topic, lag.reference) == ("/imu", INS_TOPIC)
    assert lag.lag_ns == pytest.approx(lag_ns, abs=MS)
    assert lag.correlation > 0.99
    assert (("TIM-209", "/imu") in timing_codes(inspection)) == (lag_ns != 0)
    assert not lag_ns or f"set time_offset_ns to {-lag.lag_ns}" in sentence(inspection, "TIM-209", "/imu")


def test_odometry_serves_where_there_is_no_ins_and_without_either_nothing_is_told(tmp_path: Path) -> None:
    lag = inspect(written(tmp_path / "run.mcap", SWEEPS, _odometry(), _readings(12 * MS))).clocks.imu_lag
    assert lag is not None
    assert lag.reference == ODOM_TOPIC
    assert lag.lag_ns == pytest.approx(12 * MS, abs=MS)
    assert inspect(written(tmp_path / "a.mcap", SWEEPS, _solutions())).clocks.imu_lag is None
    assert inspect(written(tmp_path / "b.mcap", SWEEPS, _readings(0))).clocks.imu_lag is None


def test_an_odometry_that_changes_its_frames_is_said_and_stops_nothing(tmp_path: Path) -> None:
    mixed = _odometry()
    for at in range(0, len(mixed), 4):
        mixed[at] = odometry(T0_NS + at * 50 * MS, SE3.identity(), child="other")
    inspection = inspect(written(tmp_path / "run.mcap", SWEEPS, mixed, _readings(0)))
    assert inspection.clocks.imu_lag is None
    assert any(found.code == "MSG-304" and found.severity == "warning" for found in inspection.findings)
