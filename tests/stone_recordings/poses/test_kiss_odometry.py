"""Poses from the sweeps alone: near the truth of a simulated drive, near the recorded ones of a real one.

Catches alone odometry by KISS-ICP that drifts, kills its process or grows with the run.
"""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.ingest.sequence import open_sequence
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from simulator.truth import SimulationTruth, read_truth
from stone.geometry.se3 import SE3
from stone_recordings.poses.kiss_odometry import LEAST_POINTS
from stone_recordings.sync.errors import NoUsablePoseError
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import LIDAR_FRAME, LIDAR_TOPIC, PERIOD_NS, T0_NS, calibration, written
from tests.stone_recordings.writing import HESAI, CloudText, Recorded, cloud_payload

pytestmark = pytest.mark.whole

ASKED = SynchroniseOptions(odometry_topic="kiss-icp")
EXAMPLES = Path(__file__).parents[3] / "examples"


def aligned(found: SE3, exact: SE3) -> SE3:
    """`found` in the frame of `exact`, so that the first poses agree."""
    return exact[0] @ found[0].inverse() @ found


def apart_m(found: SE3, exact: SE3) -> np.ndarray:
    return np.linalg.norm(aligned(found, exact).translation_m - exact.translation_m, axis=1)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulationTruth]:
    folder = tmp_path_factory.mktemp("kiss")
    simulate(folder / "run.mcap", SimulateOptions(seconds=4.0, channels=64, cameras=False), folder / "truth")
    return folder / "run.mcap", read_truth(folder / "truth")


def opened(bag: Path, options: SynchroniseOptions = ASKED):
    return open_sequence(bag, bag.with_name("run.calibration.yaml"), "kiss", options)


@pytest.fixture(scope="module")
def found(drive):
    return opened(drive[0])


def test_the_simulated_drive_is_found_level_and_all_but_its_first_sweep(drive, found):
    sequence, _ = found
    exact = drive[1].trajectory.at(sequence.frames.stamps_ns)
    length_m = np.linalg.norm(np.diff(exact.translation_m, axis=0), axis=1).sum()
    worst_m = apart_m(sequence.frames.map_from_ego, exact).max()
    assert length_m > 5
    assert worst_m < 0.02 * length_m, f"{worst_m:.3f} m over {length_m:.1f} m"
    assert sequence.pose_source == "kiss-icp 1.3.0 on /lidar_points (odometry from the sweeps)"
    assert sequence.map_origin_deg_m is None
    sequence, sweeps = found
    track = sweeps.mount.trajectory
    np.testing.assert_allclose(track.map_from_ego.translation_m[0], np.zeros(3), atol=1e-9)
    up = drive[1].trajectory.at(track.stamps_ns).rotation()[:, 2, 2]
    tilt_deg = np.rad2deg(np.arccos(up))
    apart_deg = np.rad2deg(np.arccos(track.map_from_ego.rotation()[:, 2, 2])) - tilt_deg
    assert np.abs(np.median(apart_deg)) < 0.5, f"{np.median(apart_deg):.2f}° of tilt off"
    said = next(finding for finding in sequence.findings if finding.code == "SYN-506")
    assert said.severity == "info"
    assert [(e.stamp_ns, e.code) for e in sequence.excluded] == [
        (int(drive[1].sweep_stamps_ns[0]), "no_pose_before_first")
    ]
    moved_m = sweeps.sweep(5).points_lidar[-100:] - replace(sweeps, mount=None).sweep(5).points_lidar[-100:]
    assert np.linalg.norm(moved_m, axis=1).min() > 0.05


PEAK = """
import sys
from pathlib import Path
from services.ingest.sequence import open_sequence
from services.ingest.pipeline import SynchroniseOptions

def held_kib(*_):
    lines = Path("/proc/self/status").read_text().splitlines()
    held.append(next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")))

bag, held = Path(sys.argv[1]), []
options = SynchroniseOptions(odometry_topic="kiss-icp", progress=held_kib)
open_sequence(bag, bag.with_name(f"{bag.stem}.calibration.yaml"), "kiss", options)
print(max(held))
"""


@pytest.mark.release
def test_memory_does_not_grow_with_the_length_of_the_recording(tmp_path):
    """Catches alone sweeps that are kept: four times as many, what a process holds beside the mapped file, KiB."""
    held_kib = []
    for seconds in (3.0, 12.0):
        bag = tmp_path / f"{seconds:g}.mcap"
        simulate(bag, SimulateOptions(seconds=seconds, channels=32, columns=360, cameras=False))
        ran = subprocess.run([sys.executable, "-c", PEAK, bag], check=True, capture_output=True)
        held_kib.append(int(ran.stdout))
    assert held_kib[1] < held_kib[0] + 16_000, f"{held_kib} KiB"


@pytest.mark.field_data
def test_the_real_drive_is_where_its_own_kiss_icp_put_it(field_data):
    """Catches alone poses that are right in the simulator and wrong on real sweeps.

    /odom of the recording was made by KISS-ICP, too, from clouds of full size.
    """
    bag = field_data / "kitti0005_ros2_mcap" / "kitti0005_lidar_odom.mcap"
    cal = EXAMPLES / "kitti0005.calibration.yaml"
    recorded, _ = open_sequence(bag, cal, "kitti0005")
    found, _ = open_sequence(bag, cal, "kitti0005", ASKED)
    assert len(found.frames) == len(recorded.frames) == 154
    worst_m = apart_m(found.frames.map_from_ego, recorded.frames.map_from_ego).max()
    assert worst_m < 0.15, f"{worst_m:.3f} m over 71 m"


def cloud(stamp_ns: int, points_lidar: np.ndarray, duration_ns: int = 99_000_000) -> Recorded:
    """A timed sweep of these points."""
    points = np.zeros(len(points_lidar), HESAI)
    points["x"], points["y"], points["z"] = points_lidar.T
    points["timestamp"] = stamp_ns * 1e-9 + np.linspace(0, duration_ns, len(points)) * 1e-9
    payload = cloud_payload(points, CloudText(stamp_ns=stamp_ns, frame_id=LIDAR_FRAME))
    return Recorded(LIDAR_TOPIC, "sensor_msgs/msg/PointCloud2", stamp_ns + PERIOD_NS, payload)


def degenerate(shape: str, generator: np.random.Generator) -> Iterator[np.ndarray]:
    """Eight sweeps that fix no pose, or lie."""
    count = LEAST_POINTS + 20
    for number in range(8):
        line = np.linspace(2, 60, count)
        yield {
            "one place": np.tile([[5.0, 1.0, 1.0]], (count, 1)),
            "a line": np.stack([line, 0 * line, 0 * line], axis=-1),
            "a plane": np.concatenate([generator.uniform(-40, 40, (count, 2)), np.full((count, 1), -2.0)], axis=1),
            "unrelated": generator.uniform(-60, 60, (count, 3)),
            "far too far": generator.uniform(-1, 1, (count, 3)) * (1e30 if number % 2 else 50.0),
        }[shape]


@pytest.mark.parametrize("shape", ["one place", "a line", "a plane", "unrelated", "far too far"])
def test_sweeps_that_fix_no_pose_neither_end_the_process_nor_give_poses_that_are_none(tmp_path, shape):
    generator = np.random.default_rng(1)
    sweeps = [cloud(T0_NS + k * PERIOD_NS, p) for k, p in enumerate(degenerate(shape, generator))]
    sequence, source = synchronise(written(tmp_path / "a.mcap", sweeps), calibration(), ASKED, "run")
    assert np.isfinite(source.mount.trajectory.map_from_ego.wxyz_xyz).all()
    assert len(sequence.frames) + len(sequence.excluded) == 8


def test_sweeps_of_one_time_or_with_hardly_a_point_do_not_end_the_process(tmp_path):
    """The package aborts where the spread of the times is 0."""
    generator = np.random.default_rng(2)
    points = generator.uniform(-40, 40, (500, 3))
    sweeps = [cloud(T0_NS + k * PERIOD_NS, points, duration_ns=0) for k in range(4)]
    sequence, _ = synchronise(written(tmp_path / "a.mcap", sweeps), calibration(), ASKED, "run")
    assert len(sequence.frames) > 0
    generator = np.random.default_rng(3)
    full = generator.uniform(-40, 40, (500, 3))
    sweeps = [cloud(T0_NS + k * PERIOD_NS, full[:20] if k == 3 else full) for k in range(6)]
    options = replace(ASKED, lidar_topic=LIDAR_TOPIC)
    sequence, source = synchronise(written(tmp_path / "a.mcap", sweeps), calibration(), options, "run")
    said = next(finding for finding in sequence.findings if finding.code == "SYN-505")
    assert said.message.startswith("1 of 6 sweeps")
    assert len(source.mount.trajectory) == 5
    none = [cloud(T0_NS + k * PERIOD_NS, full[:20]) for k in range(3)]
    with pytest.raises(NoUsablePoseError):
        synchronise(written(tmp_path / "b.mcap", none), calibration(), options, "run")


def test_equal_recordings_give_equal_poses(tmp_path):
    generator = np.random.default_rng(5)
    room = generator.uniform(-40, 40, (20_000, 3)).astype(np.float32)
    step_m = np.array([0.2, 0.05, 0.0])
    sweeps = [cloud(T0_NS + k * PERIOD_NS, room - k * step_m) for k in range(8)]
    path = written(tmp_path / "a.mcap", sweeps)
    first, second = (synchronise(path, calibration(), ASKED, "run")[0].frames.map_from_ego for _ in range(2))
    np.testing.assert_array_equal(first.wxyz_xyz, second.wxyz_xyz)
    steps_m = np.diff(first.translation_m, axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps_m, axis=1), np.linalg.norm(step_m), atol=0.1)


def test_a_recording_that_has_poses_is_read_without_them_when_asked(tmp_path):
    """The odometry on record may be the very thing that is wrong."""
    generator = np.random.default_rng(4)
    room = generator.uniform(-30, 30, (800, 3))
    stamps_ns = T0_NS + np.arange(6) * PERIOD_NS
    odometry = [rigs.odometry(int(stamp), rigs.world_from_ego(stamps_ns)[i]) for i, stamp in enumerate(stamps_ns)]
    path = written(tmp_path / "a.mcap", [cloud(int(stamp), room) for stamp in stamps_ns], odometry)
    sequence, _ = synchronise(path, calibration(), ASKED, "run")
    place_m = sequence.frames.map_from_ego.translation_m
    np.testing.assert_allclose(place_m, np.zeros_like(place_m), atol=0.02)
    said = next(finding for finding in sequence.findings if finding.code == "SYN-506")
    assert said.severity == "warning"
