"""The lag between gyro and pose source comes out of recorded messages, from an INS and from odometry alike."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone_recordings.report.inspection import inspect
from tests.stone.sensors.test_gyro_lag import Drive
from tests.stone_recordings.clocks.streams import IMU, MS, sentence, solutions, timing_codes
from tests.stone_recordings.rigs import ODOM_TOPIC, T0_NS, odometry, plain_sweep, written
from tests.stone_recordings.writing import Recorded, header, random_message, serialised

SECONDS = 8
INS_TOPIC = "/ins"
DRIVE = Drive(3, seconds=float(SECONDS))
# How the IMU is bolted on: on its side, looking backwards.
BODY_FROM_IMU = Rotation.from_euler("ZYX", [2.9, 0.1, 1.5])
POSES_NS = T0_NS + np.arange(SECONDS * 20, dtype=np.int64) * 50 * MS
POSES_S = (POSES_NS - T0_NS).astype(np.float64) * 1e-9
SWEEPS = [plain_sweep(T0_NS + row * 100 * MS) for row in range(SECONDS * 10)]


def _readings(lag_ns: int) -> list[Recorded]:
    """200 Hz of the drive's body rates, stamped `lag_ns` late."""
    stamps_ns, rates = DRIVE.gyro(lag_ns * 1e-9)
    stamps_ns = stamps_ns - int(DRIVE.source()[0][0]) + T0_NS
    message = random_message(IMU, np.random.default_rng(1), is_tame=True)
    recorded = []
    for stamp_ns, rate in zip(stamps_ns.tolist(), rates @ BODY_FROM_IMU.as_matrix(), strict=True):
        message.header = header(stamp_ns, "imu_link")
        velocity = message.angular_velocity
        velocity.x, velocity.y, velocity.z = rate
        recorded.append(Recorded("/imu", IMU, stamp_ns + MS, serialised(message)))
    return recorded


def _solutions() -> list[Recorded]:
    """The receiver's attitude at whole milliseconds, stamped by a host that is 1 to 5 ms late."""
    angles_deg = np.rad2deg(DRIVE.angles(POSES_S))
    late_ns = np.random.default_rng(0).integers(MS, 5 * MS, len(POSES_NS))
    attitudes = [{"azimuth": 90 - yaw, "pitch": -pitch, "roll": roll} for yaw, pitch, roll in angles_deg.tolist()]
    return solutions(INS_TOPIC, POSES_NS, late_ns, attitudes)


def _odometry() -> list[Recorded]:
    """The pose of the same body by odometry."""
    wxyz = np.roll(DRIVE.attitude(POSES_S).as_quat(), 1, axis=1)
    poses = [SE3.from_parts(quaternion, np.zeros(3)) for quaternion in wxyz]
    return [odometry(stamp_ns, pose, child="gps") for stamp_ns, pose in zip(POSES_NS.tolist(), poses, strict=True)]


@pytest.mark.parametrize("lag_ns", [0, 12 * MS, -40 * MS])
def test_the_lag_against_an_ins_is_that_at_gps_time(tmp_path: Path, lag_ns: int) -> None:
    """Its host stamps are 1 to 5 ms late, unevenly; they do not count."""
    inspection = inspect(written(tmp_path / "run.mcap", SWEEPS, _solutions(), _readings(lag_ns)))
    lag = inspection.clocks.imu_lag
    assert lag is not None
    assert (lag.topic, lag.reference) == ("/imu", INS_TOPIC)
    assert lag.lag_ns == pytest.approx(lag_ns, abs=MS)
    assert lag.correlation > 0.99
    assert (("TIM-209", "/imu") in timing_codes(inspection)) == (lag_ns != 0)


def test_what_to_set_is_in_the_sentence(tmp_path: Path) -> None:
    inspection = inspect(written(tmp_path / "run.mcap", SWEEPS, _solutions(), _readings(12 * MS)))
    assert inspection.clocks.imu_lag is not None
    told = sentence(inspection, "TIM-209", "/imu")
    assert f"set time_offset_ns to {-inspection.clocks.imu_lag.lag_ns}" in told
    assert f"after {INS_TOPIC}" in told


def test_odometry_serves_where_there_is_no_ins(tmp_path: Path) -> None:
    lag = inspect(written(tmp_path / "run.mcap", SWEEPS, _odometry(), _readings(12 * MS))).clocks.imu_lag
    assert lag is not None
    assert lag.reference == ODOM_TOPIC
    assert lag.lag_ns == pytest.approx(12 * MS, abs=MS)


def test_without_an_imu_or_a_pose_source_nothing_is_told(tmp_path: Path) -> None:
    assert inspect(written(tmp_path / "a.mcap", SWEEPS, _solutions())).clocks.imu_lag is None
    assert inspect(written(tmp_path / "b.mcap", SWEEPS, _readings(0))).clocks.imu_lag is None


def test_an_odometry_that_changes_its_frames_is_said_and_stops_nothing(tmp_path: Path) -> None:
    mixed = _odometry()
    for at in range(0, len(mixed), 4):
        mixed[at] = odometry(T0_NS + at * 50 * MS, SE3.identity(), child="other")
    inspection = inspect(written(tmp_path / "run.mcap", SWEEPS, mixed, _readings(0)))
    assert inspection.clocks.imu_lag is None
    assert any(found.code == "MSG-304" and found.severity == "warning" for found in inspection.findings)
