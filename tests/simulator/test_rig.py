"""The rig's geometry and clockwork, without a world."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.options import LIDAR_HZ, SimulateOptions
from simulator.pipeline import sweep_stamps_ns, tick_stamps_ns, write_calibration
from simulator.scenery.movers import (
    S_NS,
    WALKER_HEIGHT_M,
    Mover,
    Route,
    Schedule,
    Vehicle,
    Walker,
    movers_of,
    walker_ahead,
)
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.sensors import rig
from simulator.sensors.lidar import robot_range
from stone.geometry.se3 import SE3
from stone_recordings.calibrations.file import read_calibration
from testing.refusals import refused_as


def test_cameras_look_along_their_yaw_when_the_lidar_looks_their_way() -> None:
    for camera in rig.cameras():
        assert 0 < camera.phase_ns < rig.SWEEP_NS
        column = round(camera.phase_ns / rig.SWEEP_NS * 3600)
        looks = rig.EGO_FROM_LIDAR.rotation() @ rig.lidar_directions(2, 3600)[column, 0]
        off_rad = np.arctan2(looks[1], looks[0]) - camera.yaw_rad
        assert np.cos(off_rad) == pytest.approx(1.0, abs=1e-5)
    for camera in rig.cameras():
        rotation = rig.ego_from_camera(camera).rotation()
        np.testing.assert_allclose(rotation[:, 2], [np.cos(camera.yaw_rad), np.sin(camera.yaw_rad), 0], atol=1e-12)
        np.testing.assert_allclose(rotation[:, 1], [0, 0, -1], atol=1e-12)


def test_the_lidar_turns_clockwise_from_plus_y_in_its_own_frame() -> None:
    fan = rig.lidar_directions(3, 360)
    azimuth = np.unwrap(np.arctan2(fan[:, 1, 0], fan[:, 1, 1]))
    assert np.all(np.diff(azimuth) > 0)
    np.testing.assert_allclose(np.linalg.norm(fan, axis=-1), 1.0)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(fan[0, :, 2])), [15, -5, -25], atol=1e-9)


@given(st.integers(12, 7200))
def test_packets_divide_the_columns(columns: int) -> None:
    steps = rig.sweep_steps(columns)
    assert 1 <= steps <= 100
    assert columns % steps == 0


@pytest.mark.parametrize(("columns", "steps"), [(900, 100), (1800, 100)])
def test_usual_sweeps_have_a_pose_every_millisecond(columns: int, steps: int) -> None:
    assert rig.sweep_steps(columns) == steps


def test_the_lidar_sees_the_pole_and_of_the_robot_only_what_is_in_its_self_boxes() -> None:
    offset = np.array([*rig.POLE_EGO_XY_M, 0.0])
    distance = np.linalg.norm(offset)
    towards = rig.EGO_FROM_LIDAR.rotation().T @ (offset / distance)
    seen = robot_range(np.stack([towards, -towards]))
    assert seen[0] == pytest.approx(distance - rig.POLE_RADIUS_M, abs=1e-6)
    assert np.isinf(seen[1])
    directions = rig.lidar_directions(128, 1800).reshape(-1, 3)
    reach = robot_range(directions)
    hit = np.isfinite(reach)
    points = rig.EGO_FROM_LIDAR @ (directions[hit] * reach[hit, None].astype(np.float64))
    inside = np.zeros(len(points), bool)
    for box in rig.SELF_BOXES_EGO:
        inside |= np.all((points >= np.array(box.min_m) + 0.06) & (points < np.array(box.max_m) - 0.06), axis=1)
    assert hit.sum() > 100
    assert inside.all()


def test_the_calibration_file_reads_back_as_the_rig(tmp_path: Path) -> None:
    rigged = rig.calibration(480)
    write_calibration(rigged, tmp_path / "rig.yaml")
    read, findings = read_calibration(tmp_path / "rig.yaml")
    assert not [finding for finding in findings if finding.severity == "error"]
    assert [mount.name for mount in read.mounts] == [mount.name for mount in rigged.mounts]
    np.testing.assert_allclose(read.ego_from_lidar.wxyz_xyz, rigged.ego_from_lidar.wxyz_xyz, atol=1e-12)
    for ours, theirs in zip(rigged.mounts, read.mounts, strict=True):
        np.testing.assert_allclose(theirs.lidar_from_sensor.as_matrix(), ours.lidar_from_sensor.as_matrix(), atol=1e-12)
        assert (theirs.kind, theirs.frame_id, theirs.intrinsics) == (ours.kind, ours.frame_id, ours.intrinsics)
    assert read.self_boxes_ego == rigged.self_boxes_ego


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seconds", 0.0), ("seconds", float("nan")), ("channels", 1), ("columns", 8000), ("compression", "rar"),
        ("faults", ("rtk_gap", "bad_luck")), ("noise_ratio", -1.0), ("noise_ratio", float("nan")), ("lidar_hz", 7),
        ("transport_jitter_ns", 5_000_000), ("host_delay_max_ns", -1), ("lidar_hz", 0), ("traffic", "jam"),
        ("camera_detail", "fine"), ("illumination", "noon"),
    ],
)  # fmt: skip
def test_options_beyond_the_rig_are_refused(name: str, value: object) -> None:
    with refused_as("bad_simulation_option", match=name):
        SimulateOptions(**{name: value})


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


def test_traffic_is_nobody_one_walker_or_five_and_who_has_arrived_stands() -> None:
    def kinds(traffic: str) -> list[type]:
        options = replace(SimulateOptions(), traffic=traffic)
        return [type(mover) for mover in movers_of(options, straight_drive(), Flat())]

    assert kinds("none") == []
    assert kinds("walker") == [Walker]
    assert kinds("busy") == [Walker, Walker, Walker, Vehicle, Vehicle]
    assert SimulateOptions().traffic == "walker"
    parking = route(Schedule(12.0, -2.0, 6.0))
    assert [parking.is_standing(after(seconds)) for seconds in (0.0, 2.9, 3.0, 15.0)] == [False, False, True, True]
    assert not route(Schedule(12.0, -2.0)).is_standing(after(3.0))


def test_nobody_walks_into_the_robot_and_the_walker_crosses_five_seconds_before_it() -> None:
    drive = straight_drive()
    for mover in movers_of(SimulateOptions(traffic="busy", seconds=14.0), drive, Flat()):
        for stamp_ns in range(START_NS, after(14.0), S_NS // 10):
            robot = drive.at(np.array([stamp_ns])).translation_m
            assert not mover.is_inside(robot + np.array([0.0, 0.0, 0.4]), stamp_ns, 0.6).any()
    place, _ = walker_ahead(straight_drive(), Flat()).route.at(after(2.0))  # a quarter of its sway
    np.testing.assert_allclose(place, [-2.5, 14.0, 0.5], atol=1e-6)


@pytest.mark.parametrize("lidar_hz", LIDAR_HZ)
def test_sweeps_come_at_their_rate_and_the_other_sensors_at_theirs(lidar_hz: int) -> None:
    options = SimulateOptions(seconds=3.0, lidar_hz=lidar_hz)
    assert len(sweep_stamps_ns(options)) == 3 * lidar_hz
    assert set(np.diff(sweep_stamps_ns(options))) == {10**9 // lidar_hz}
    assert len(tick_stamps_ns(options)) == 30
    assert options.sweep_ns == (50_000_000 if lidar_hz == 20 else 100_000_000)
