"""A biased heading or pitch shows in the direction of every step, and hills, curves and noise do not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.driving_direction import driving_direction, turned_to_way


def drive(yaw_deg=0.0, pitch_deg=0.0, aside=0.0, count=400, seed=5, wander_m=0.0):
    """A winding way over hills, its tangent the robot's x; the poses are turned by a bias in the ego frame."""
    rng, s = np.random.default_rng(seed), np.linspace(0, 40, count)
    places = np.stack([s, 3 * np.sin(s / 6), 0.8 * np.sin(s / 5)], axis=1)
    x, y, z = np.gradient(places, s, axis=0).T
    heading, climb = np.arctan2(y, x) + aside * rng.uniform(-1, 1, count), np.arctan2(z, np.hypot(x, y))
    noise = rng.normal(0, 0.1, (2, count))
    attitude = Rotation.from_euler("ZYX", np.stack([heading, -climb, 0 * s], axis=1))
    bias = Rotation.from_euler(
        "ZYX", np.stack([yaw_deg + noise[0], -pitch_deg - noise[1], 0 * s], axis=1), degrees=True
    )
    wxyz = np.roll((attitude * bias).as_quat(), 1, axis=1)
    places += np.sqrt(2) * wander_m * np.sin(s[:, None] * [0.0, 0.6, 0.0])
    return Trajectory((s * 1e9).astype(np.int64), SE3.from_parts(wxyz, places + rng.normal(0, 0.01, places.shape)))


@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(0.0, 0.0), (0.3, -0.5), (-1.0, 0.0), (0.0, 2.0), (1.5, -2.0)])
def test_the_bias_is_found_and_what_is_small_is_not_called_one(yaw_deg, pitch_deg):
    found = driving_direction(drive(yaw_deg, pitch_deg))
    assert np.rad2deg(found.yaw_rad) == pytest.approx(-yaw_deg, abs=0.25)
    assert np.rad2deg(found.pitch_rad) == pytest.approx(-pitch_deg, abs=0.25)
    assert (found.is_yawed, found.is_pitched) == (abs(yaw_deg) >= 1, abs(pitch_deg) >= 2)


@pytest.mark.parametrize("wander_m", [0.0, 0.04, 0.07])
def test_positions_that_wander_to_and_fro_are_measured_to_the_side(wander_m):
    found = driving_direction(drive(0.5, 0.0, wander_m=wander_m))
    assert found.aside_m == pytest.approx(wander_m, rel=0.25, abs=0.015)
    assert not found.is_yawed


def test_an_ego_origin_ahead_of_the_axle_slides_aside_in_curves_and_that_is_no_bias():
    axle, ahead = drive(), SE3.from_parts(np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.5, 0.0, 0.0]))
    found = driving_direction(Trajectory(axle.stamps_ns, axle.map_from_ego @ ahead))
    assert np.rad2deg(found.yaw_rad) == pytest.approx(0.0, abs=0.3)
    assert not found.is_yawed
    one_curve = np.arange(70, 170)  # of 10 m, all to one side
    curved = driving_direction(Trajectory(axle.stamps_ns[one_curve], (axle.map_from_ego @ ahead)[one_curve]))
    assert curved is None or not curved.is_yawed


def test_a_robot_that_drives_any_way_and_a_short_way_say_nothing():
    assert driving_direction(drive(1.0, aside=0.3)) is None
    whole = drive(1.0)
    short = Trajectory(whole.stamps_ns[:80], whole.map_from_ego[np.arange(80)])
    assert driving_direction(short) is None
    turned = SE3.from_parts(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
    assert driving_direction(Trajectory(whole.stamps_ns, whole.map_from_ego @ turned)) is None


def test_with_the_mount_that_is_named_an_ins_faces_where_the_robot_drives():
    place = SE3.from_parts(np.array([0.9, 0.1, -0.2, 0.3]), np.array([0.2, -0.1, 0.4]))
    rig = Calibration("rig", SE3.from_parts(np.array([1.0, 0.0, 0.02, 0.0]), np.array([0.1, 0.0, 1.1])))
    entered = Mount("INS", "ins", rig.ego_from_lidar.inverse() @ place)
    faulty = drive(1.5, -2.0)
    found = driving_direction(faulty)
    (right,) = turned_to_way(replace(rig, mounts=(entered,)), found.yaw_rad, found.pitch_rad)
    ego_from_ins = rig.ego_from_lidar @ right.lidar_from_sensor
    np.testing.assert_allclose(ego_from_ins.translation_m, place.translation_m, atol=1e-9)
    again = driving_direction(Trajectory(faulty.stamps_ns, faulty.map_from_ego @ place @ ego_from_ins.inverse()))
    # To what the lever arm of 0.4 m adds where the ground is bent.
    assert np.rad2deg([again.yaw_rad, again.pitch_rad]) == pytest.approx([0.0, 0.0], abs=0.25)
