"""Lags of poses behind sweeps, of turns whose truth is a formula."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.sweep_lag import FEWEST_TURNS, SweepTurns, sweep_lag

GAP_NS = 250_000_000
START_NS = 1_700_000_000_000_000_000
NOISE_RAD = np.deg2rad(0.05)


def rotations(stamps_ns):
    """Where a robot on rough ground looks: sums of waves about all three axes."""
    t = (stamps_ns - START_NS) * 1e-9
    yaw = 0.5 * np.sin(0.4 * t) + 0.2 * np.sin(0.9 * t + 1)
    pitch, roll = 0.03 * np.sin(1.9 * t), 0.04 * np.sin(2.3 * t + 2)
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))


def poses(stamps_ns, turned=rotations):
    wxyz = turned(stamps_ns).as_quat()[:, [3, 0, 1, 2]]
    return SE3.from_parts(wxyz, np.zeros((len(stamps_ns), 3)))


def track_late_by(seconds, turned=rotations):
    """Poses at 20 Hz whose stamps are so much later than the moments that they tell of."""
    stamps_ns = START_NS + np.arange(0, 20_000_000_000, 50_000_000)
    return Trajectory(stamps_ns + round(seconds * 1e9), poses(stamps_ns, turned))


def turns(count=16, noise_rad=NOISE_RAD, mount=None, turned=rotations):
    """What sweeps half a second apart tell, in an ego frame that the mount turns."""
    rng = np.random.default_rng(3)
    begin_ns = START_NS + np.linspace(1_000_000_000, 18_500_000_000, count).astype(np.int64)
    end_ns = begin_ns + 500_000_000
    relative = turned(begin_ns).inv() * turned(end_ns) * Rotation.from_rotvec(rng.normal(0, noise_rad, (count, 3)))
    if mount is not None:
        relative = mount.inv() * relative * mount
    return SweepTurns(begin_ns, end_ns, relative.as_quat()[:, [3, 0, 1, 2]])


@pytest.mark.parametrize("late_s", [0.0, 0.05, -0.05, 0.1, -0.1, 0.2, -0.3])
def test_a_lag_is_found_within_its_error(late_s):
    found = sweep_lag(turns(), track_late_by(late_s), GAP_NS)
    assert found is not None
    assert abs(found.lag_ns * 1e-9 - late_s) < max(4 * found.sigma_ns * 1e-9, 0.001)
    assert found.sigma_ns < 8e6
    assert found.residual_rad < 4 * NOISE_RAD
    assert found.unshifted_rad == pytest.approx(found.residual_rad, rel=0.3) or abs(late_s) > 0


def test_a_third_of_wrong_registrations_moves_it_little():
    measured = turns(24)
    rng = np.random.default_rng(8)
    wrong = measured.wxyz.copy()
    wrong[::3] = Rotation.random(8, random_state=rng).as_quat()[:, [3, 0, 1, 2]]
    found = sweep_lag(SweepTurns(measured.begin_ns, measured.end_ns, wrong), track_late_by(0.1), GAP_NS)
    assert found is not None
    assert found.lag_ns == pytest.approx(100e6, abs=8e6)


def test_a_mount_that_is_turned_by_two_degrees_does_not_hide_it():
    mount = Rotation.from_euler("ZYX", [2, 1, -1], degrees=True)
    found = sweep_lag(turns(24, mount=mount), track_late_by(0.1), GAP_NS)
    assert found is not None
    assert found.lag_ns == pytest.approx(100e6, abs=10e6)


def straight(stamps_ns):
    return Rotation.from_rotvec(np.zeros((len(stamps_ns), 3)))


def circle(stamps_ns):
    return Rotation.from_rotvec((stamps_ns[:, None] - START_NS) * 1e-9 * np.array([0.0, 0.0, 0.4]))


@pytest.mark.parametrize("turned", [straight, circle])
def test_where_no_turn_changes_nothing_certain_is_said_of_time(turned):
    found = sweep_lag(turns(turned=turned), track_late_by(0.1, turned), GAP_NS)
    assert found is None or found.sigma_ns > 15e6


def test_too_few_turns_within_the_track_say_nothing():
    assert sweep_lag(turns(FEWEST_TURNS - 1), track_late_by(0.1), GAP_NS) is None
    short = track_late_by(0.0)
    cut = Trajectory(short.stamps_ns[:80], short.map_from_ego[:80])
    assert sweep_lag(turns(), cut, GAP_NS) is None
    assert sweep_lag(turns(0), short, GAP_NS) is None
