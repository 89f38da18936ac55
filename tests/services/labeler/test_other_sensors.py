"""Labels of one simulated run as people record it: the LiDAR as packets, the poses by other messages.

Catches alone packets that are deskewed, mapped or counted otherwise than clouds, and poses that are right at the frames
and wrong between them; for that, four runs of labelling, some 15 s of processor time each. What was measured is
recorded as properties of the tests.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from services.ingest.pipeline import SynchroniseOptions
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from simulator.sensors import rig
from simulator.truth import read_truth
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.messages.lidars.points import AZIMUTH_DEG, ELEVATION_DEG
from stone_recordings.messages.pointcloud2 import decode_cloud
from stone_recordings.messages.sweep_clouds import sweep_cloud
from testing.worlds.faults.outcome import LabelledDrive, agreement, labelled
from tests.stone_recordings import rigs
from tests.stone_recordings.messages.lidars.encoding import SentPacket, pandar_scan
from tests.stone_recordings.pose_messages import (
    WITH_COVARIANCE,
    pose_message,
)
from tests.stone_recordings.writing import CloudText, Recorded, cloud_payload, write_mcap

pytestmark = pytest.mark.release

COLUMNS, LASERS, BLOCKS = 900, 40, 10
OPTIONS = SimulateOptions(
    seconds=3.5, seed=7, channels=LASERS, columns=COLUMNS, cameras=False, noise_ratio=0.0, world_width_m=60.0
)
LIDAR = "/lidar_points"
DRIVER_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<i4")])
AZIMUTH = (16_500 + 40 * np.arange(COLUMNS)) % 36_000


@dataclass(frozen=True, eq=False)
class OneRun:
    """Its sweeps as points and as packets, its poses (world, z up) at 20 Hz, and its labels by Odometry."""

    folder: Path
    rig: Calibration
    clouds: list[Recorded]
    packets: list[Recorded]
    stamps_ns: NDArray[np.int64]
    sweeps_ns: NDArray[np.int64]
    truth: Callable[[NDArray[np.int64]], SE3]
    plain: LabelledDrive

    def labelled(self, name: str, messages: list[Recorded], **options: object) -> LabelledDrive:
        return _labelled(self.folder / name, self.rig, messages, SynchroniseOptions(**options))  # type: ignore[arg-type]

    def alike(self, made: LabelledDrive) -> float:
        assert made.grids.keys() == self.plain.grids.keys()
        return agreement(made.grids, self.plain.grids)


def pandar_directions(_channels: int, _columns: int) -> NDArray[np.float64]:
    """The rays of a Pandar40P by its maker's angles, (columns, lasers, 3)."""
    turn = np.deg2rad(AZIMUTH[:, None] / 100 + AZIMUTH_DEG["Pandar40P"])
    up = np.broadcast_to(np.deg2rad(ELEVATION_DEG["Pandar40P"]), turn.shape)
    return np.stack([np.cos(up) * np.sin(turn), np.cos(up) * np.cos(turn), np.sin(up)], axis=-1)


def _labelled(
    folder: Path, calibration: Calibration, messages: list[Recorded], options: SynchroniseOptions
) -> LabelledDrive:
    folder.mkdir()
    bag = write_mcap(folder / "run.mcap", sorted(messages, key=lambda message: message.log_time_ns))
    return labelled(bag, calibration, folder / "labels", options)


def packets_of(cloud: Recorded) -> Recorded:
    """The same sweep as a Pandar40P sends it, ten columns a packet, in steps of 4 mm."""
    read = decode_cloud(memoryview(cloud.payload))
    points = read.points.reshape(COLUMNS, LASERS)
    range_m = np.linalg.norm(np.stack([points[axis] for axis in "xyz"], axis=-1).astype(np.float64), axis=-1)
    counts = np.rint(range_m / 0.004).astype(np.int64)
    sent, stamps_ns = list[bytes](), list[int]()
    for first in range(0, COLUMNS, BLOCKS):
        block = slice(first, first + BLOCKS)
        time_ns = round(float(points["timestamp"][block].mean()) * 1e9) + 304_000  # fired 304 µs before, in the mean
        packet = SentPacket("Pandar40P", time_ns // 1000 % 10**6, AZIMUTH[block].tolist(), counts[block])
        sent.append(packet.content)
        stamps_ns.append(time_ns)
    payload = pandar_scan(sent, stamps_ns, read.stamp_ns)
    return Recorded("/pandar_packets", "pandar_msgs/msg/PandarScan", cloud.log_time_ns, payload)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> OneRun:
    folder = tmp_path_factory.mktemp("people")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(rig, "lidar_directions", pandar_directions)
        simulate(folder / "run.mcap", OPTIONS, folder / "truth")
    calibration, _ = read_calibration(calibration_path(folder / "run.mcap"))
    with open_bag(folder / "run.mcap") as bag:
        kind = bag.type_of(LIDAR)
        clouds = [Recorded(LIDAR, kind, one.log_time_ns, bytes(one.payload)) for one in bag.messages(LIDAR)]
    truth = read_truth(folder / "truth")
    sweeps_ns = truth.sweep_stamps_ns
    stamps_ns = np.arange(sweeps_ns[0] - 150_000_000, sweeps_ns[-1] + 200_000_000, 50_000_000)
    at = truth.trajectory.at
    told = odometry(stamps_ns, at(stamps_ns))
    plain = _labelled(folder / "plain", calibration, clouds + told, SynchroniseOptions())
    return OneRun(folder, calibration, clouds, [packets_of(one) for one in clouds], stamps_ns, sweeps_ns, at, plain)


def odometry(stamps_ns: NDArray[np.int64], poses: SE3) -> list[Recorded]:
    return [rigs.odometry(int(stamp), poses[row]) for row, stamp in enumerate(stamps_ns)]


def as_cloud(packets: Recorded, log_time_ns: int) -> Recorded:
    """The points that packets decode to, as a driver publishes them."""
    cloud = sweep_cloud(memoryview(packets.payload), packets.type)
    points = np.empty(len(cloud.points), DRIVER_POINT)
    for name in ("x", "y", "z", "intensity", "ring"):
        points[name] = cloud.points[name]
    points["t"] = cloud.points["time_stamp"]
    said = CloudText(stamp_ns=cloud.stamp_ns, frame_id=cloud.frame_id)
    return Recorded(LIDAR, "sensor_msgs/msg/PointCloud2", log_time_ns, cloud_payload(points, said))


def test_a_run_recorded_as_packets_is_labelled_as_the_points_they_hold(
    run: OneRun, record_property: Callable[..., None]
) -> None:
    """Catches alone packets whose points lie or are timed otherwise than those that a driver publishes.

    From the points before they were packed it differs by steps of 4 mm and of up to 0.6 ms, which on a reference of
    a few metres of way moves voxels near its limit to the other class: that is recorded, and bounded loosely.
    """
    poses = odometry(run.stamps_ns, run.truth(run.stamps_ns))
    made = run.labelled("packets", run.packets + poses)
    clouds = [as_cloud(one, one.log_time_ns) for one in run.packets]
    same = run.labelled("unpacked", clouds + poses)
    record_property("unpacked_alike", agreement(made.grids, same.grids))
    record_property("original_alike", run.alike(made))
    assert {one.code for one in made.report.findings} >= {"TOP-116"}
    assert agreement(made.grids, same.grids) == 1.0
    assert run.alike(made) > 0.8


def test_stamped_poses_label_as_odometry_does(run: OneRun) -> None:
    poses, kind = run.truth(run.stamps_ns), WITH_COVARIANCE
    posed = [pose_message(int(stamp), poses[row], kind, "/pose", "map") for row, stamp in enumerate(run.stamps_ns)]
    made = run.labelled("posed", run.clouds + posed, poses_frame="base_link")
    assert run.alike(made) == 1.0
