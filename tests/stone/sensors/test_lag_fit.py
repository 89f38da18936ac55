"""Offsets of clocks in worlds of known truth: found, with the errors that are told, and not where nothing tells."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.lag_fit import LagEvidence, TurnEvidence, fitted_lag
from stone.sensors.sensor_motion import SensorMotion
from stone.sensors.sweep_lag import FEWEST_TURNS, SweepTurns, sweep_lag
from testing.worlds.driven_motion import driven_track, motion_of, speeds_seen, standing_track, turns_seen

LATE_S = 0.083
DRIVES = 24
Seen = Callable[[SensorMotion, int], LagEvidence]


def pictures(motion: SensorMotion, seed: int) -> LagEvidence:
    return turns_seen(motion, motion, LATE_S, seed)


def detections(motion: SensorMotion, seed: int) -> LagEvidence:
    return speeds_seen(motion, LATE_S, seed)


@pytest.mark.whole
@pytest.mark.parametrize("seen", [pictures, detections])
def test_the_offset_lies_within_its_errors_as_often_as_they_say(seen: Seen) -> None:
    """Catches alone errors that are too small or too large; of 24 drives 14 to 24 lie within two of them by chance."""
    apart = []
    for seed in range(DRIVES):
        found = fitted_lag([seen(motion_of(driven_track(seed)), seed)], (-0.6, 0.6))
        assert found is not None
        apart.append((found.offset_s + LATE_S) / found.sigma_s)
    within = [float(np.mean(np.abs(apart) < sigmas)) for sigmas in (1.0, 2.0)]
    assert 0.4 <= within[0] <= 0.92
    assert within[1] >= 0.8
    assert 0.7 <= float(np.sqrt(np.mean(np.square(apart)))) <= 1.5


@pytest.mark.whole
@pytest.mark.parametrize("late_s", [-7.5, -0.1, 0.0, 3.3])
def test_any_offset_in_the_search_is_found_from_either_side(late_s: float) -> None:
    motion = motion_of(driven_track(1))
    found = fitted_lag([turns_seen(motion, motion, late_s, 1, noise=0.05)], (-10.0, 10.0))
    assert found is not None
    assert abs(found.offset_s + late_s) < 0.002


def test_sensors_of_one_clock_tell_more_together() -> None:
    """Four cameras know the time twice as well as one, half more or less."""
    motion = motion_of(driven_track(2))
    cameras = [turns_seen(motion, motion, LATE_S, seed) for seed in range(4)]
    alone, together = fitted_lag(cameras[:1], (-0.6, 0.6)), fitted_lag(cameras, (-0.6, 0.6))
    assert alone is not None
    assert together is not None
    assert 0.25 < together.sigma_s / alone.sigma_s < 0.75


@pytest.mark.whole
def test_a_robot_that_stands_and_the_motion_of_another_tell_nothing() -> None:
    for seed in range(4):
        own, other = motion_of(driven_track(seed)), motion_of(driven_track(seed + 900))
        assert fitted_lag([turns_seen(own, other, LATE_S, seed)], (-5.0, 5.0)) is None
    still = motion_of(standing_track())
    for seen in (turns_seen(still, still, 0.0, 1), speeds_seen(still, 0.0, 1)):
        assert fitted_lag([seen], (-1.0, 1.0)) is None


def test_a_motion_that_repeats_itself_could_be_at_two_times() -> None:
    """Two turns of one period apart explain each other."""
    motion = motion_of(driven_track(3))
    period = 200  # steps of 5 ms
    repeated = SensorMotion(
        motion.begin_s,
        np.tile(motion.rates[:period], (18, 1)),
        np.concatenate([motion.sums[:period] + number * motion.sums[period] for number in range(18)]),
        np.zeros(18 * period),
    )
    begin_s = np.arange(4.0, 12.0, 0.1)
    seen = TurnEvidence(
        repeated, begin_s, begin_s + 0.1, repeated.between(begin_s, begin_s + 0.1)[:, :3], has_way=False
    )
    assert fitted_lag([seen], (-3.0, 3.0)) is None


def test_what_lies_outside_the_track_is_not_told() -> None:
    motion = motion_of(driven_track(4))
    assert fitted_lag([turns_seen(motion, motion, 30.0, 4)], (-1.0, 1.0)) is None


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


def lag_of(measured, track):
    found = sweep_lag(measured, track, GAP_NS)
    assert found is not None
    return found


@pytest.mark.parametrize("late_s", [0.0, 0.05, -0.05, 0.1, -0.1, 0.2, -0.3])
def test_a_lag_is_found_within_its_error(late_s):
    found = lag_of(turns(), track_late_by(late_s))
    assert abs(found.lag_ns * 1e-9 - late_s) < max(4 * found.sigma_ns * 1e-9, 0.001)
    assert found.sigma_ns < 8e6
    assert found.residual_rad < 4 * NOISE_RAD
    assert found.unshifted_rad == pytest.approx(found.residual_rad, rel=0.3) or abs(late_s) > 0


def test_a_third_of_wrong_registrations_moves_it_little():
    measured = turns(24)
    rng = np.random.default_rng(8)
    wrong = measured.wxyz.copy()
    wrong[::3] = Rotation.random(8, random_state=rng).as_quat()[:, [3, 0, 1, 2]]
    found = lag_of(SweepTurns(measured.begin_ns, measured.end_ns, wrong), track_late_by(0.1))
    assert found.lag_ns == pytest.approx(100e6, abs=8e6)


def test_a_mount_that_is_turned_by_two_degrees_does_not_hide_it():
    mount = Rotation.from_euler("ZYX", [2, 1, -1], degrees=True)
    found = lag_of(turns(24, mount=mount), track_late_by(0.1))
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
