"""Who moves in a simulated world: where they are, what rays meet of them, and how often the LiDAR looks."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.options import LIDAR_HZ, SimulateOptions, SimulationOptionError
from simulator.pipeline import sweep_stamps_ns, tick_stamps_ns
from simulator.scenery.movers import WALKER_HEIGHT_M, Mover, Vehicle, Walker, movers_of, walker_ahead
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.scenery.route import S_NS, Route, Schedule
from stone.geometry.se3 import SE3

SPEED_M_S, SECONDS = 2.0, 20
START_NS = 1_000_000_000_000


class Flat:
    """Ground at z = 0.5 everywhere."""

    def elevation_m(self, xy):
        return np.full(np.shape(xy)[:-1], 0.5)


def straight_drive() -> DriveTrajectory:
    """Along +y from the origin, at a constant speed."""
    time_s = np.arange(SECONDS * S_NS // POSE_NS + 1) * POSE_NS * 1e-9
    places = np.stack([0 * time_s, SPEED_M_S * time_s, 0 * time_s + 0.5], axis=-1)
    quarter = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    return DriveTrajectory(START_NS, SE3.from_parts(np.tile(quarter, (len(time_s), 1)), places))


def route(schedule: Schedule, aside_m: float = 0.0) -> Route:
    return Route(straight_drive(), Flat(), schedule, aside_m)


def after(seconds: float) -> int:
    return START_NS + round(seconds * S_NS)


@pytest.mark.parametrize(
    ("schedule", "place_y_m"),
    [(Schedule(3.0), 2.0 * 7), (Schedule(20.0, -1.0), 2.0 * 16), (Schedule(-10.0, 3.0), 4.0), (Schedule(-9.0), -10.0),
     (Schedule(25.0), 58.0), (Schedule(26.0, -2.0, 20.0), 40.0), (Schedule(0.0, 3.0, 9.0), 18.0)],
)  # fmt: skip
def test_after_four_seconds_a_mover_is_where_its_schedule_says(schedule: Schedule, place_y_m: float) -> None:
    place, heading = route(schedule, aside_m=1.5).at(after(4.0))
    np.testing.assert_allclose(place, [-1.5, place_y_m, 0.5], atol=1e-6)
    assert heading == pytest.approx(np.pi / 2)


def test_who_has_reached_where_the_schedule_ends_stands_there() -> None:
    parking = route(Schedule(12.0, -2.0, 6.0))
    assert [parking.is_standing(after(seconds)) for seconds in (0.0, 2.9, 3.0, 15.0)] == [False, False, True, True]
    assert not route(Schedule(12.0, -2.0)).is_standing(after(3.0))


@pytest.mark.parametrize("mover", [Walker(route(Schedule(2.0))), Vehicle(route(Schedule(2.0), 1.0))])
def test_rays_end_where_a_mover_begins(mover: Mover) -> None:
    """The oracle walks along each ray in steps of a centimetre, and asks each time whether that is inside."""
    rng = np.random.default_rng(5)
    origins = np.float32([3.0, 3.0, 1.4]) + rng.normal(0, 0.2, (300, 3)).astype(np.float32)
    aims = mover.route.at(after(0.0))[0] + rng.uniform([-1, -1, 0], [1, 1, 2.2], (300, 3)) * [
        mover.reach_m,
        mover.reach_m,
        1,
    ]
    directions = aims.astype(np.float32) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = mover.ranges_m(after(0.0), origins, directions)
    steps_m = np.arange(0.0, 12.0, 0.01)
    walked = origins[:, None].astype(np.float64) + steps_m[:, None] * directions[:, None].astype(np.float64)
    is_inside = mover.is_inside(walked.reshape(-1, 3), after(0.0), 0.0).reshape(300, -1)
    hit = np.isfinite(ranges)
    assert 60 < hit.sum() < 280
    ends = origins + np.where(hit, ranges, 0)[:, None] * directions
    assert mover.is_inside(ends[hit].astype(np.float64), after(0.0), 1e-4).all()
    assert not (is_inside[hit] & (steps_m < ranges[hit, None] - 1e-4)).any()
    is_through_the_roof = walked[np.arange(300), is_inside.argmax(axis=1), 2] > 0.5 + WALKER_HEIGHT_M - 0.02
    assert not is_inside[~hit & ~is_through_the_roof].any()  # a walker's roof is not cast


def test_traffic_is_nobody_one_walker_or_three_and_two_vehicles() -> None:
    def kinds(traffic: str) -> list[type]:
        options = replace(SimulateOptions(), traffic=traffic)
        return [type(mover) for mover in movers_of(options, straight_drive(), Flat())]

    assert kinds("none") == []
    assert kinds("walker") == [Walker]
    assert kinds("busy") == [Walker, Walker, Walker, Vehicle, Vehicle]
    assert SimulateOptions().traffic == "walker"


def test_nobody_walks_or_drives_into_the_robot() -> None:
    drive = straight_drive()
    for mover in movers_of(SimulateOptions(traffic="busy", seconds=14.0), drive, Flat()):
        for stamp_ns in range(START_NS, after(14.0), S_NS // 10):
            robot = drive.at(np.array([stamp_ns])).translation_m
            assert not mover.is_inside(robot + np.array([0.0, 0.0, 0.4]), stamp_ns, 0.6).any()


def test_the_walker_ahead_crosses_the_track_five_seconds_before_the_robot() -> None:
    place, _ = walker_ahead(straight_drive(), Flat()).route.at(after(2.0))  # a quarter of its sway
    np.testing.assert_allclose(place, [-2.5, 14.0, 0.5], atol=1e-6)


@pytest.mark.parametrize("lidar_hz", LIDAR_HZ)
def test_sweeps_come_at_their_rate_and_the_other_sensors_at_theirs(lidar_hz: int) -> None:
    options = SimulateOptions(seconds=3.0, lidar_hz=lidar_hz)
    assert len(sweep_stamps_ns(options)) == 3 * lidar_hz
    assert set(np.diff(sweep_stamps_ns(options))) == {10**9 // lidar_hz}
    assert len(tick_stamps_ns(options)) == 30
    assert options.sweep_ns == (50_000_000 if lidar_hz == 20 else 100_000_000)


@pytest.mark.parametrize(("name", "value"), [("lidar_hz", 7), ("lidar_hz", 0), ("traffic", "jam")])
def test_other_rates_and_other_traffic_are_refused(name: str, value: object) -> None:
    with pytest.raises(SimulationOptionError, match=name):
        replace(SimulateOptions(), **{name: value})
