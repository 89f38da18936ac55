"""A simulated drive measured without noise: poses within 2 mm and 0.02° of exact, deskewed points within 5 mm."""

from dataclasses import dataclass

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from services.ingest.sequence import open_sequence
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from simulator.scenery.world import ORIGIN_DEG_M
from simulator.sensors import rig
from simulator.truth import SimulationTruth, read_truth
from stone.geometry.se3 import SE3
from stone.sensors.pose_quality import Rtk
from stone.sensors.sequence import Sequence
from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.pointcloud2 import decode_cloud, lidar_points
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.sync.samples import radars_of
from stone_recordings.sync.sweeps import BagSweeps

OPTIONS = SimulateOptions(seconds=3.0, seed=5, channels=16, columns=300, cameras=False, noise_ratio=0.0)


@dataclass(frozen=True, eq=False)
class Drive:
    """What ingest made of the bag, and what was true."""

    sequence: Sequence
    sweeps: BagSweeps
    truth: SimulationTruth

    def world_from_map(self) -> SE3:
        """The map is east, north, up at the first solution, the world at the simulation's own origin."""
        origin = self.sequence.map_origin_deg_m
        assert origin is not None
        turn = ecef_from_enu(*ORIGIN_DEG_M[:2]).inv() * ecef_from_enu(*origin[:2])
        place = np.array(pymap3d.geodetic2enu(*origin, *ORIGIN_DEG_M))
        return SE3.from_parts(np.roll(turn.as_quat(), 1), place)

    def world_from_ego(self) -> SE3:
        return self.world_from_map() @ self.sequence.frames.map_from_ego


def ecef_from_enu(latitude_deg: float, longitude_deg: float) -> Rotation:
    return Rotation.from_euler("ZX", [90 + longitude_deg, 90 - latitude_deg], degrees=True)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("exact")
    simulate(folder / "run.mcap", OPTIONS, folder / "truth")
    sequence, sweeps = open_sequence(folder / "run.mcap", folder / "run.calibration.yaml", "exact")
    return Drive(sequence, sweeps, read_truth(folder / "truth"))


def turned_deg(a: SE3, b: SE3) -> np.ndarray:
    between = (a.inverse() @ b).wxyz
    return np.asarray(np.rad2deg(2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=1), np.abs(between[:, 0]))))


def test_poses_are_within_two_millimetres_and_two_hundredths_of_a_degree(drive):
    frames = drive.sequence.frames
    assert len(frames) == 30
    assert set(frames.quality.rtk.tolist()) == {Rtk.FIXED}
    exact, found = drive.truth.trajectory.at(frames.stamps_ns), drive.world_from_ego()
    apart_mm = np.linalg.norm(found.translation_m - exact.translation_m, axis=1) * 1e3
    turn_deg = turned_deg(exact, found)
    assert apart_mm.max() < 2.0
    assert turn_deg.max() < 0.02


def test_deskewed_points_are_where_a_robot_that_stands_still_would_measure_them(drive):
    """Every point, moved by the exact path from where it was measured to where the LiDAR stood at the stamp."""
    worst_mm, raw_mm = [], []
    with open_bag(drive.sweeps.path) as bag:
        for index in range(0, len(drive.sweeps), 3):
            stamp_ns = int(drive.sweeps.stamps_ns[index])
            payload = bag.message(drive.sweeps.topic, int(drive.sweeps.message_index[index])).payload
            raw = lidar_points(decode_cloud(payload))
            map_from_lidar = drive.truth.trajectory.at(stamp_ns + raw.offset_ns) @ rig.EGO_FROM_LIDAR
            at_stamp = (drive.truth.trajectory.at(np.array([stamp_ns])) @ rig.EGO_FROM_LIDAR)[0]
            exact = at_stamp.inverse() @ (map_from_lidar @ raw.points_lidar.astype(np.float64))
            found = drive.sweeps.sweep(index).points_lidar
            worst_mm.append(np.linalg.norm(found - exact, axis=1).max() * 1e3)
            raw_mm.append(np.linalg.norm(raw.points_lidar - exact, axis=1).max() * 1e3)
    assert max(worst_mm) < 5.0
    assert max(raw_mm) > 100.0


def test_still_things_stand_still_for_the_radars(drive):
    radars = radars_of(drive.sequence, drive.sweeps)
    assert sorted(radars) == ["RADAR_FRONT", "RADAR_LEFT", "RADAR_RIGHT"]
    radar = radars["RADAR_FRONT"]
    seen = [radar.frame(index) for index in range(5, 25)]
    moving = np.concatenate([frame.range_rate_m_s for frame in seen])
    over_ground = np.concatenate([frame.ground_rate_m_s for frame in seen])
    assert median_abs(moving) > 1.0
    assert median_abs(over_ground) < 0.05
    with open_bag(drive.sweeps.path) as bag:
        row = int(radar.taken.message_index[12])
        raw = decode_radar("ars548_messages/msg/DetectionList", [bag.message(radar.taken.topic, row)])
    dt_ns = int(radar.taken.dt_ns[12])
    stamp_ns = int(radar.stamps_ns[12])
    exact = drive.truth.trajectory.at(np.array([stamp_ns, stamp_ns + dt_ns])) @ rig.EGO_FROM_LIDAR
    expected = exact[0].inverse() @ (exact[1] @ (radar.lidar_from_radar @ raw.points_radar[raw.is_valid]))
    np.testing.assert_allclose(radar.frame(12).points_lidar, expected, atol=5e-3)


def median_abs(values: np.ndarray) -> float:
    return float(np.nanmedian(np.abs(values)))
