"""Each fault of the outside worlds does to the ideal data of a drive what it says, and nothing else."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from testing.outside.faults import FAULTS
from testing.outside.lidar import Lidar
from testing.outside.recording import Recordable, recordable
from testing.outside.track import Track
from tests.testing.outside.places import FLAT

IDEAL = recordable(Track(FLAT, 20.0), Lidar(8, 90), np.full((200, 8, 90), 12.0, np.float32))


def faulty(name: str) -> Recordable:
    return FAULTS[name](IDEAL, np.random.default_rng(5))


def altered_parts(drive: Recordable) -> set[str]:
    return {
        name
        for name in ("ranges_m", "pose_s", "world_from_ins", "is_fixed", "ego_from_lidar")
        if not np.array_equal(getattr(drive, name), getattr(IDEAL, name))
    }


def turned_deg(drive: Recordable) -> np.ndarray:
    turn = np.swapaxes(IDEAL.world_from_ins[:, :3, :3], 1, 2) @ drive.world_from_ins[:, :3, :3]
    return np.rad2deg(Rotation.from_matrix(turn).magnitude())


def test_every_fault_alters_its_own_part_of_the_data_and_leaves_the_ideal_alone() -> None:
    before = replace(IDEAL, ranges_m=IDEAL.ranges_m.copy(), world_from_ins=IDEAL.world_from_ins.copy())
    parts = {name: altered_parts(faulty(name)) for name in FAULTS}
    mounts = {name: {"ego_from_lidar"} for name in FAULTS if name.startswith("mount")}
    assert parts == mounts | {
        "sound": set(),
        "poses 50 ms late": {"pose_s"},
        "RTK float 10 cm": {"world_from_ins", "is_fixed"},
        "yaw bias 1°": {"world_from_ins"},
        "INS tilted 2°": {"world_from_ins"},
        "body pitched 2°": {"ego_from_lidar", "world_from_ins"},
        "poses jump 0.6 m": {"world_from_ins"},
        "rain": {"ranges_m"},
    }
    assert altered_parts(before) == set()


def test_mounts_are_entered_as_far_off_as_they_say() -> None:
    assert np.isclose(faulty("mount 23 cm low").ego_from_lidar[2, 3], IDEAL.ego_from_lidar[2, 3] - 0.23)
    tilt = faulty("mount pitch 2°").ego_from_lidar[:3, :3]
    np.testing.assert_allclose(np.rad2deg(Rotation.from_matrix(tilt).as_rotvec()), [0, 2, 0], atol=1e-9)


def test_poses_are_as_far_off_as_they_say() -> None:
    np.testing.assert_allclose(turned_deg(faulty("yaw bias 1°")), 1.0)
    np.testing.assert_allclose(turned_deg(faulty("INS tilted 2°")), 2.0)
    np.testing.assert_allclose(faulty("poses 50 ms late").pose_s - IDEAL.pose_s, 0.05)
    off = faulty("poses jump 0.6 m").world_from_ins[:, :3, 3] - IDEAL.world_from_ins[:, :3, 3]
    half = (len(off) + 1) // 2
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), np.repeat([0.0, 0.6], [half, len(off) - half]), atol=1e-9)
    drift = faulty("RTK float 10 cm").world_from_ins[:, :3, 3] - IDEAL.world_from_ins[:, :3, 3]
    assert 0.05 < np.sqrt((drift**2).mean()) < 0.2


def test_rain_drops_and_shortens_rays_as_often_as_it_says() -> None:
    ranges = faulty("rain").ranges_m
    assert abs(np.isinf(ranges).mean() - 0.15) < 0.01
    assert abs((ranges < 12.0).mean() - 0.03) < 0.005
