"""A simulated run as a bag of the release is inspected, synchronised and labelled right, and its oddities are named."""

import re
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from services.domain.sequences.processing import PROCESS
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sandboxed_inspection import inspected_in
from services.ingest.sequence import open_sequence
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate, sweep_stamps_ns
from simulator.scenery.world import build_world
from simulator.sensors import rig
from stone.sensors.sequence import Sequence
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import Inspection, inspect
from stone_recordings.sync.sweeps import BagSweeps
from testing.once import made_once
from testing.refusals import refused_as
from testing.worlds.release_bags import (
    RELEASED,
    ReleasedBag,
    ReleasedRadar,
    release_calibration,
    write_release_bag,
)
from testing.worlds.runs import bring, run_all
from tests.stone_client.participating import stone

DRIVE = SimulateOptions(seconds=5.0, seed=3, channels=16, columns=240, camera_width_px=48, world_width_m=30.0)
TWO_FRAMES = replace(DRIVE, seconds=0.2, channels=4, columns=90, cameras=False)
YAWS_DEG = {"RADAR_FRONT": 0.0, "RADAR_BACK_LEFT": 120.0, "RADAR_BACK_RIGHT": -120.0}


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        write_release_bag(folder / "farm_rosbag", DRIVE)

    return made_once(tmp_path_factory, "release-bag", make) / "farm_rosbag"


@pytest.fixture(scope="module")
def inspection(bag: Path) -> Inspection:
    with open_bag(bag) as opened:
        return inspected_in(opened)


def synchronised(bag: Path, ground: str = "given") -> tuple[Sequence, BagSweeps]:
    options = SynchroniseOptions(ground=ground, is_checked=False)  # type: ignore[arg-type]
    return open_sequence(bag, release_calibration(bag), "farm", options)


def rows_of(sequence: Sequence, options: SimulateOptions) -> NDArray[np.int64]:
    """Which sweep of the bag each frame is."""
    return np.searchsorted(sweep_stamps_ns(options), sequence.frames.stamps_ns)


def test_rows_lie_topic_after_topic_and_every_message_of_a_frame_has_one_bag_time(bag: Path) -> None:
    (database,) = bag.glob("*.db3")
    with sqlite3.connect(database) as connection:
        rows = connection.execute("SELECT topic_id, timestamp FROM messages ORDER BY id").fetchall()
    topics = [topic for topic, _ in rows]
    assert topics == sorted(topics)
    times = {topic: [time for of, time in rows if of == topic] for topic in topics}
    *sensors, static = times.values()
    assert len(sensors) == 1 + 3 + 1 + 6
    assert all(one == sensors[0] for one in sensors)
    assert (len(sensors[0]), len(static)) == (50, 1)


def test_radars_are_named_by_their_yaws_and_what_cannot_be_so_is_named_with_the_value_used(
    inspection: Inspection,
) -> None:
    roles = {topic.topic.name: topic.role for topic in inspection.topics}
    assert {name: roles[name] for name in ("/lidar_points", "/pva/odom", "/PointCloudDetectionradar2")} == {
        "/lidar_points": "lidar", "/pva/odom": "odometry", "/PointCloudDetectionradar2": "radar"
    }  # fmt: skip
    channels = inspection.assignment.channels
    assert {channel: channels[channel] for channel in YAWS_DEG} == {
        channel: radar.topic for channel, radar in zip(YAWS_DEG, RELEASED.radars, strict=True)
    }
    said = {(one.code, one.topic): one.message for one in inspection.findings}
    for (channel, yaw_deg), radar in zip(YAWS_DEG.items(), RELEASED.radars, strict=True):
        message, number = said["TOP-117", radar.topic], radar.frame_id.rpartition("_")[2]
        assert f"by {yaw_deg:+.0f}°, but its name contains {number}°; the yaw is used, which gives {channel}" in message
    assert "positions from the calibration" in said["CAL-438", ""]
    assert not {"TOP-110", "TOP-112"} & {code for code, _ in said}
    assert inspection.lidar_ground is not None
    assert inspection.lidar_ground.height_m == pytest.approx(-rig.EGO_FROM_LIDAR.translation_m[2], abs=0.04)


@pytest.mark.parametrize(
    ("radars", "severities"),
    [
        ((("ARS_0", 0.0), ("ARS_120", 120.0), ("ARS_240", -120.0)), {"info"}),  # counted to the left
        ((("ARS_0", 0.0), ("ARS_120", -120.0), ("ARS_240", 120.0)), {"info"}),  # or to the right
        ((("radar_1", 0.0), ("radar_2", 120.0), ("radar_3", -120.0)), {"info"}),  # mere numbers
        ((("ARS_0", 0.0), ("ARS_120", 90.0), ("ARS_240", -120.0)), {"info", "warning"}),
        ((("front", 0.0), ("left", 90.0), ("right", -90.0)), set()),
        ((("front", 0.0), ("left", -90.0), ("right", 90.0)), {"warning"}),
    ],
)
def test_a_name_that_agrees_with_its_yaw_is_no_contradiction(
    tmp_path: Path, radars: tuple[tuple[str, float], ...], severities: set[str]
) -> None:
    topics = (radar.topic for radar in RELEASED.radars)
    named = tuple(ReleasedRadar(topic, *one) for topic, one in zip(topics, radars, strict=True))
    mounts_m = {"hesai_lidar": (0.16, 0.12, 0.54)}
    folder = write_release_bag(tmp_path / "small", TWO_FRAMES, ReleasedBag(radars=named, mounts_m=mounts_m))
    found = inspect(folder)
    assert {one.severity for one in found.findings if one.code == "TOP-117"} == severities
    assert "CAL-438" not in {one.code for one in found.findings}, "one position was entered"
    assert len(YAWS_DEG) == sum(channel.startswith("RADAR") for channel in found.assignment.channels)


def test_a_mount_on_no_ground_is_named_with_its_correction_before_there_is_a_calibration(
    inspection: Inspection, tmp_path: Path
) -> None:
    height_m = rig.EGO_FROM_LIDAR.translation_m[2]
    (told,) = [one for one in inspection.findings if one.code == "CAL-440"]
    assert (told.severity, told.topic) == ("warning", "")
    seen = re.search(r"'base_link' in /tf_static, the ground lies ([\d.]+) m below the ego origin", told.message)
    right = re.search(r"use --ground auto, which mounts the LiDAR ([\d.]+) m above", told.message)
    assert seen is not None
    assert right is not None
    assert float(seen[1]) == float(right[1]) == pytest.approx(height_m, abs=0.04)
    mounts_m = {"hesai_lidar": (0.16, 0.12, height_m)}
    placed = write_release_bag(tmp_path / "placed", replace(DRIVE, seconds=1.0), ReleasedBag(mounts_m=mounts_m))
    with open_bag(placed) as opened:
        found = inspected_in(opened)
    assert found.lidar_ground is not None
    assert "CAL-440" not in {one.code for one in found.findings}


def test_a_ground_that_is_far_off_stops_the_command_before_the_run_is_synchronised(bag: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.tum"  # of another day: synchronising refuses them
    poses.write_text("".join(f"{second} {second} 0 0 0 0 0 1\n" for second in range(10)))
    asked = ("label", bag, "--calibration", release_calibration(bag), "-o", tmp_path / "labels", "--poses", poses)
    stopped = stone(*asked)
    assert stopped.exit_code == 1
    assert stopped.stderr.startswith("footprint_off_ground: the ground lies 0.4")
    assert "ego_from_lidar at [" in stopped.stderr
    assert "ground auto corrects it for this run" in stopped.stderr
    assert not (tmp_path / "labels").exists()
    corrected = stone(*asked, "--ground", "auto")
    assert corrected.exit_code == 1
    assert "footprint_off_ground" not in corrected.stderr


def test_a_ground_that_is_far_off_stops_a_run_when_it_is_planned(platform: Platform, bag: Path) -> None:
    brought = bring(platform)
    brought.calibrate(release_calibration(bag))
    brought.add(bag)
    run_all(platform)
    codes = {one["code"] for one in brought.recording().findings}
    assert {"CAL-438", "CAL-440", "TOP-117"} <= codes
    run = brought.process()
    run_all(platform)
    assert brought.job(run).failure_code == "footprint_off_ground"
    assert {job.kind for job in brought.jobs(run) if job.state == "failed"} == {PROCESS, "labeler.parts"}
    assert not [job for job in brought.jobs(run) if job.kind == "labeler.fuse"]


@pytest.mark.parametrize("ground", ["given", "auto"])
def test_the_lidar_is_where_it_was_and_each_frame_takes_its_own_radar_lists(bag: Path, ground: str) -> None:
    """Mounts of zero move nothing, and ground auto moves the ego origin, not the LiDAR."""
    sequence, _ = synchronised(bag, ground)
    frames = sequence.frames
    lidar = frames.map_from_ego @ sequence.calibration.ego_from_lidar
    driven = build_world(DRIVE).trajectory.at(frames.stamps_ns) @ rig.EGO_FROM_LIDAR
    np.testing.assert_allclose(lidar.translation_m, driven.translation_m, atol=1e-6)
    rows = rows_of(sequence, DRIVE)
    assert len(rows) == 48, "the first sweep begins before the first pose, and the last ends after the last"
    for channel, yaw_deg in YAWS_DEG.items():
        taken = frames.associations[channel]
        np.testing.assert_array_equal(taken.message_index, rows)
        assert np.ptp(taken.dt_ns) > 0
        assert np.abs(taken.dt_ns).max() <= 28_000_000
        mount = sequence.calibration.mount(channel)
        assert mount is not None
        ahead = (sequence.calibration.ego_from_lidar @ mount.lidar_from_sensor).rotation()[:, 0]
        assert np.rad2deg(np.arctan2(ahead[1], ahead[0])) == pytest.approx(yaw_deg, abs=0.6)
    codes = {one.code for one in sequence.findings}
    assert {"CAL-438", "CAL-439"} <= codes
    assert "CAL-414" not in codes, "the rotations agree, and positions were not entered"
    assert ("CAL-434" in codes) is (ground == "auto")


def tops(folder: Path, tokens: tuple[str, ...]) -> NDArray[np.uint8]:
    """The class of the highest occupied voxel of each column, 0 of none: (frames, x, y)."""
    found = []
    for token in tokens:
        with np.load(folder / "gts" / "farm" / token / "labels.npz") as arrays:
            grid = arrays["semantics"][:, :, ::-1]
        highest = (grid > 0).argmax(axis=2)[:, :, None]
        found.append(np.take_along_axis(grid, highest, axis=2)[:, :, 0])
    return np.stack(found)


def test_it_is_labelled_as_the_same_drive_with_the_right_mount_once_the_ground_is_corrected(
    bag: Path, tmp_path: Path
) -> None:
    options = LabelOptions(parameters_for("field"))
    simulate(tmp_path / "run.mcap", DRIVE)
    sound = open_sequence(tmp_path / "run.mcap", calibration_path(tmp_path / "run.mcap"), "farm")
    label(*sound, tmp_path / "sound", options)
    with refused_as("footprint_off_ground", match="0.4. m below"):
        label(*synchronised(bag), tmp_path / "given", options)
    report = label(*synchronised(bag, "auto"), tmp_path / "auto", options)
    tokens = report.sequence.frames.tokens
    ours, theirs = tops(tmp_path / "auto", tokens), tops(tmp_path / "sound", tokens)
    in_both, in_either = (ours > 0) & (theirs > 0), (ours > 0) | (theirs > 0)
    assert in_both.sum() > 0.8 * in_either.sum()
    assert (ours == theirs)[in_both].mean() > 0.96


@pytest.mark.release
def test_a_bag_of_1781_frames_is_synchronised_frame_by_frame(tmp_path: Path) -> None:
    """Catches alone rows that are taken in the wrong order beyond what a reader holds at a time."""
    long = replace(DRIVE, seconds=178.1, channels=4, columns=60, cameras=False)
    folder = write_release_bag(tmp_path / "long", long)
    sequence, _ = synchronised(folder)
    driven = build_world(long).trajectory.at(sequence.frames.stamps_ns) @ rig.EGO_FROM_LIDAR
    lidar = sequence.frames.map_from_ego @ sequence.calibration.ego_from_lidar
    np.testing.assert_allclose(lidar.translation_m, driven.translation_m, atol=1e-6)
    rows = rows_of(sequence, long)
    assert len(rows) >= 1779
    np.testing.assert_array_equal(sequence.frames.associations["RADAR_BACK_LEFT"].message_index, rows)
