"""Places of one track: whatever a vehicle cannot have reached is left out, and nothing else."""

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone_recordings.poses.places import is_near, local_poses, near_geodetic, refuse_degrees
from stone_recordings.sync.recorded_messages import OrderedStamps

COUNT = 400
STAMPS_NS = np.arange(COUNT) * 100_000_000 + 1_700_000_000_000_000_000
ALONG_M = np.stack(
    [447_321 + np.linspace(0, 600, COUNT), 5_411_952 + np.linspace(0, 300, COUNT), np.full(COUNT, 312.0)], -1
)


@pytest.mark.parametrize("rows", [slice(0, 9), slice(100, 103), slice(395, 400), slice(0, 150), slice(1, None, 3)])
def test_zeros_are_left_out_wherever_they_are(rows: slice) -> None:
    place_m, wrong = ALONG_M.copy(), np.zeros(COUNT, np.bool_)
    place_m[rows], wrong[rows] = 0.0, True
    np.testing.assert_array_equal(is_near(STAMPS_NS, place_m), ~wrong)


def test_a_long_drive_and_one_that_jumps_for_good_are_kept_whole() -> None:
    assert is_near(STAMPS_NS * 100, ALONG_M * 100).all()
    jumped = ALONG_M.copy()
    jumped[COUNT // 2 :] += 5000.0
    assert is_near(STAMPS_NS, jumped).all()


def test_a_receiver_that_writes_zeros_loses_these() -> None:
    latitude, longitude, height_m = np.full(COUNT, 49.0), np.full(COUNT, 8.4), np.full(COUNT, 30.0)
    for values in (latitude, longitude, height_m):
        values[:20] = 0.0
    height_m[50:60] = 0.0
    ordered = OrderedStamps(np.arange(COUNT), STAMPS_NS, ())
    left, findings = near_geodetic("/ins", ordered, (latitude, longitude, height_m))
    assert left.index.tolist() == [row for row in range(COUNT) if row >= 20 and not 50 <= row < 60]
    assert [finding.code for finding in findings] == ["GNS-310"]
    assert "30 of 400" in findings[0].message
    height_m[:] = 0.0  # a track at sea level, or in plan
    assert len(near_geodetic("/ins", ordered, (latitude + 49.0 * (latitude == 0), longitude, height_m))[0].index) == 380


@pytest.mark.parametrize("noise_m", [0.0, 1e-6, 1e-4, 3e-3, 0.05])
def test_a_robot_that_stands_is_not_in_degrees(noise_m: float) -> None:
    generator = np.random.default_rng(3)
    place_m = np.array([12.3, -4.5, 0.0]) + generator.normal(0, 1, (COUNT, 3)) * noise_m
    poses = SE3.from_parts(np.array([1.0, 0, 0, 0]), place_m)
    refuse_degrees("/odom", STAMPS_NS, poses)
    np.testing.assert_array_equal(local_poses("/odom", STAMPS_NS, poses).poses.wxyz_xyz, poses.wxyz_xyz)
