"""Offsets of clocks in worlds of known truth: found, with the errors that are told, and not found where nothing tells.

The many drives catch alone an error that is told too small or too large, which no single drive can show.
"""

from collections.abc import Callable

import numpy as np
import pytest

from stone.sensors.lag_evidence import TurnEvidence
from stone.sensors.lag_fit import LagEvidence, fitted_lag
from stone.sensors.sensor_motion import SensorMotion
from testing.worlds.driven_motion import driven_track, motion_of, speeds_seen, standing_track, turns_seen

LATE_S = 0.083
DRIVES = 24
Seen = Callable[[SensorMotion, int], LagEvidence]


def pictures(motion: SensorMotion, seed: int) -> LagEvidence:
    return turns_seen(motion, motion, LATE_S, seed)


def detections(motion: SensorMotion, seed: int) -> LagEvidence:
    return speeds_seen(motion, LATE_S, seed)


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


@pytest.mark.parametrize("seed", range(6))
def test_the_motion_of_another_robot_tells_nothing(seed: int) -> None:
    own, other = motion_of(driven_track(seed)), motion_of(driven_track(seed + 900))
    assert fitted_lag([turns_seen(own, other, LATE_S, seed)], (-5.0, 5.0)) is None


def test_a_robot_that_stands_tells_nothing() -> None:
    motion = motion_of(standing_track())
    assert fitted_lag([turns_seen(motion, motion, 0.0, 1)], (-1.0, 1.0)) is None
    assert fitted_lag([speeds_seen(motion, 0.0, 1)], (-1.0, 1.0)) is None


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
