"""A track that jumps is split, and each frame knows how good its pose is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.pose_quality import PoseQuality, Rtk, quality_at, unknown_quality
from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.novatel import FixSamples, decode_inspva
from stone_recordings.poses.ego_track import LEAST_SAMPLES, imu_topic, is_still, levelled, split_at_jumps
from stone_recordings.poses.quality import HOLD_NS, rtk_of, solution_quality
from stone_recordings.poses.sources import PoseTrack
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from stone_recordings.sync.stored_recording import StoredRecording, StoredRecordingFile
from stone_recordings.sync.sweeps import read_sweeps, sweeps_bytes
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, calibration, ins_messages, placed, written
from tests.stone_recordings.writing import Recorded, header, random_message, serialised

SWEEPS_NS = T0_NS + 20_300_000 + np.arange(20) * PERIOD_NS
POSES_NS = T0_NS + np.arange(-2, 46) * 50_000_000
JUMP = 22
KEPT = StoredRecording("a.mcap", (StoredRecordingFile("key", "a.mcap"),))


def jumped(pos_type_after: int = 56, by_m: float = 1.0):
    """The INS track, `by_m` to the north from pose `JUMP` on."""
    after = ins_messages(POSES_NS[JUMP:], seed=1, pos_type=pos_type_after, north_m=by_m)
    return ins_messages(POSES_NS[:JUMP]) + after


def synchronised(path, poses):
    sweeps = [rigs.wall_sweep(int(stamp)) for stamp in SWEEPS_NS]
    return synchronise(written(path, sweeps, poses), calibration(), SynchroniseOptions(), "run")


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    return synchronised(tmp_path_factory.mktemp("split") / "a.mcap", jumped(55))


def test_a_jump_is_said_with_the_status_and_sweeps_across_it_are_excluded(split):
    sequence, _ = split
    finding = next(f for f in sequence.findings if f.code == "GNS-302")
    assert finding.topic == rigs.INS_TOPIC
    assert f"at {POSES_NS[JUMP]} ns while the status changed from fixed to float" in finding.message
    sequence, sweeps = split
    across = [
        int(stamp) for stamp in SWEEPS_NS if stamp < POSES_NS[JUMP] and stamp + PERIOD_NS * 0.9975 > POSES_NS[JUMP - 1]
    ]
    assert [e.stamp_ns for e in sequence.excluded] == across
    assert {e.code for e in sequence.excluded} == {"pose_jump"}
    assert all(len(sweeps.sweep(i).points_lidar) == 400 for i in range(len(sequence.frames)))
    sequence, _ = split
    quality = sequence.frames.quality
    expected = ["float" if stamp > POSES_NS[JUMP] else "fixed" for stamp in sequence.frames.stamps_ns]
    assert quality.rtk_words() == expected
    np.testing.assert_allclose(quality.stdev_m, 0.012, atol=1e-6)
    assert set(quality.gap_ns.tolist()) == {50_000_000}
    said = next(f for f in sequence.findings if f.code == "GNS-301")
    assert "RTK was fixed only 45.8 % of the time (54.2 % float)" in said.message


def test_a_jump_without_a_change_of_status_is_found_and_doubtful_positions_are_counted(tmp_path):
    sequence, _ = synchronised(tmp_path / "a.mcap", jumped(56))
    finding = next(f for f in sequence.findings if f.code == "GNS-302")
    assert f"at {POSES_NS[JUMP]} ns while the status was fixed" in finding.message
    sequence, _ = synchronised(tmp_path / "a.mcap", ins_messages(POSES_NS, stdev_m=0.25))
    said = next(f for f in sequence.findings if f.code == "GNS-304")
    assert said.message == "20 of 20 frames have a position stdev above 0.1 m (worst 0.250 m)"


def test_both_sides_of_a_jump_stay_where_their_source_put_them(split, tmp_path):
    whole, _ = synchronised(tmp_path / "a.mcap", ins_messages(POSES_NS))
    sequence, _ = split
    by_stamp = dict(zip(whole.frames.stamps_ns.tolist(), whole.frames.map_from_ego.translation_m, strict=True))
    apart_m = sequence.frames.map_from_ego.translation_m - [by_stamp[s] for s in sequence.frames.stamps_ns.tolist()]
    is_after = sequence.frames.stamps_ns > POSES_NS[JUMP]
    np.testing.assert_allclose(apart_m[~is_after], 0, atol=1e-3)
    np.testing.assert_allclose(apart_m[is_after], np.tile([0, 1.0, 0], (is_after.sum(), 1)), atol=1e-3)


def test_the_files_for_the_labeler_keep_it_all(split, tmp_path):
    sequence, sweeps = split
    read = read_sequence(sequence_bytes(sequence))
    for name, values in vars(sequence.frames.quality).items():
        np.testing.assert_array_equal(getattr(read.frames.quality, name), values)
    assert read.frames.sweeps.topic == rigs.LIDAR_TOPIC
    assert read.frames.sweeps.message_index.tolist() == sweeps.message_index.tolist()
    assert sequence_bytes(read) == sequence_bytes(sequence)
    there = read_sweeps(sweeps_bytes(sweeps, KEPT), lambda kept: sweeps.path)
    assert there.mount.trajectory.segment.tolist() == sweeps.mount.trajectory.segment.tolist()
    np.testing.assert_array_equal(there.sweep(3).points_lidar, sweeps.sweep(3).points_lidar)


def test_odometry_has_no_status_and_no_deviation(tmp_path):
    stamps_ns = T0_NS + np.arange(30) * PERIOD_NS
    poses = rigs.world_from_ego(stamps_ns)
    leap = SE3(np.where(np.arange(30)[:, None] >= 15, 1.0, 0.0) * np.eye(7)[4:5] * 2 + poses.wxyz_xyz)
    odometry = [rigs.odometry(int(stamp), leap[i]) for i, stamp in enumerate(stamps_ns)]
    sweeps = [rigs.plain_sweep(int(stamp) + 30_000_000) for stamp in stamps_ns[:-1]]
    sequence, _ = synchronise(written(tmp_path / "a.mcap", sweeps, odometry), calibration(), SynchroniseOptions(), "r")
    assert set(sequence.frames.quality.rtk_words()) == {"unknown"}
    assert np.isnan(sequence.frames.quality.stdev_m).all()
    finding = next(f for f in sequence.findings if f.code == "GNS-302")
    assert "1.98 m at" in finding.message
    assert [e.stamp_ns for e in sequence.excluded] == [stamps_ns[14] + 30_000_000]


def test_an_inspva_takes_its_quality_from_the_last_bestpos_for_half_a_second():
    samples = decode_inspva(ins_messages(POSES_NS))
    plain = replace(samples, pos_type=None, position_stdev_m=None)
    rows = np.arange(len(POSES_NS))
    fix_ns = np.array([POSES_NS[4] + 1, POSES_NS[4] - 25_000_000], np.int64)
    nothing = np.zeros(2)
    stdev_m = np.array([[0.02, 0.03, 0.04], [0.2, -1.0, np.inf]])
    types, status = np.array([50, 34], np.uint32), np.zeros(2, np.uint32)
    fixes = FixSamples(fix_ns, fix_ns, status.astype(np.uint8), status, types, *[nothing] * 4, stdev_m)
    found = solution_quality(plain, rows, fixes)
    held = [Rtk.FLOAT if stamp <= POSES_NS[4] else Rtk.FIXED for stamp in POSES_NS]
    is_held = (fix_ns[1] <= POSES_NS) & (POSES_NS - fix_ns[0] <= HOLD_NS)
    assert found.rtk.tolist() == [rtk if known else Rtk.UNKNOWN for rtk, known in zip(held, is_held, strict=True)]
    np.testing.assert_allclose(found.stdev_m[5], [0.03, 0.02, 0.04])
    np.testing.assert_array_equal(found.stdev_m[4], [np.nan, 0.2, np.nan])
    assert np.isnan(found.stdev_m[0]).all()
    assert solution_quality(plain, rows, None).rtk.tolist() == [Rtk.UNKNOWN] * len(rows)


def test_position_types_no_manual_knows_are_unknown():
    types = np.array([0, 16, 17, 32, 50, 56, 75, 4_000_000_000], np.uint32)
    words = [Rtk(value).word for value in rtk_of(types).tolist()]
    assert words == ["none", "single", "differential", "float", "fixed", "fixed", "unknown", "unknown"]


def test_between_two_poses_the_worse_holds():
    stamps_ns = np.array([0, 10, 20], np.int64)
    track = Trajectory(stamps_ns, SE3.identity((3,)))
    solution = solution_quality(
        replace(
            decode_inspva(ins_messages(POSES_NS[:3])),
            pos_type=np.array([56, 55, 56], np.uint32),
            position_stdev_m=np.array([[0.1, 0.1, 0.1], [0.3, 0.2, 0.1], [0.0, 0.0, 0.0]]),
        ),
        np.arange(3),
        None,
    )
    found: PoseQuality = quality_at(track, solution, np.array([0, 4, 10, 15, 20], np.int64))
    assert found.rtk_words() == ["fixed", "float", "float", "float", "fixed"]
    assert found.gap_ns.tolist() == [0, 10, 0, 10, 0]
    np.testing.assert_allclose(found.stdev_m[:, 0], [0.1, 0.2, 0.2, 0.2, 0.0])


PERIOD_NS = 100_000_000
STEP_M = 0.3


def track(offsets_m: dict[int, float], count: int = 60, step_m: float = STEP_M) -> PoseTrack:
    """Straight ahead, with some poses beside it."""
    places_m = np.zeros((count, 3))
    places_m[:, 0] = np.arange(count) * step_m
    for row, offset_m in offsets_m.items():
        places_m[row, 1] = offset_m
    poses = SE3.from_parts(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), places_m)
    trajectory = Trajectory(np.arange(count, dtype=np.int64) * PERIOD_NS, poses)
    return PoseTrack(trajectory, "odometry", "/odom", solution=unknown_quality(count))


def codes(found: PoseTrack) -> list[str]:
    return [finding.code for finding in found.findings]


@pytest.mark.parametrize("rows", [[30], [10, 40], [20, 25]])
def test_poses_that_are_alone_off_the_track_are_left_out(rows: list[int]) -> None:
    found = split_at_jumps(track({row: 2.0 + row for row in rows}))
    assert codes(found) == ["GNS-305"]
    assert f"{len(rows)} single poses" in found.findings[0].message
    assert f"{2.0 + rows[-1]:.2f} m at {rows[-1] * PERIOD_NS} ns" in found.findings[0].message
    assert not set(np.array(rows) * PERIOD_NS) & set(found.trajectory.stamps_ns.tolist())
    assert len(found.trajectory) == 60 - len(rows)
    assert found.solution is not None
    assert len(found.solution.rtk) == 60 - len(rows)
    assert not found.trajectory.map_from_ego.translation_m[:, 1].any()


def test_a_track_that_does_not_come_back_or_is_off_often_keeps_its_poses() -> None:
    found = split_at_jumps(track({row: 5.0 for row in range(30, 60)}))
    assert codes(found) == ["GNS-302"]
    assert len(found.trajectory) == 60
    found = split_at_jumps(track({row: 5.0 for row in range(3, 60, 4)}))
    assert "GNS-305" not in codes(found)
    assert len(found.trajectory) == 60
    sound = track({})
    assert split_at_jumps(sound) is sound


def test_poses_stand_where_they_never_move() -> None:
    assert is_still(track({}, step_m=0.0).trajectory)
    assert not is_still(track({}, step_m=0.001).trajectory)
    assert not is_still(track({}, count=1).trajectory)
    turned = track({}, step_m=0.0).trajectory
    wxyz_xyz = turned.map_from_ego.wxyz_xyz.copy()
    wxyz_xyz[30:, :4] = [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]
    assert not is_still(Trajectory(turned.stamps_ns, SE3(wxyz_xyz)))


IMU = rigs.MOUNTS[3]
STEP_NS = 5_000_000
GRAVITY_ALIGNMENT_POSES_NS = T0_NS + np.arange(0, 8_000_000_001, 50_000_000, dtype=np.int64)
IMU_NS = T0_NS + np.arange(0, 8_000_000_001, 4 * STEP_NS, dtype=np.int64)
SLOPE = placed([np.deg2rad(14), np.deg2rad(-9), 0.3], [5.0, -2.0, 1.0])


def forces(gravity_m_s2: float) -> np.ndarray:
    """What the IMU measures on the circle of the rig: its acceleration by second differences, and gravity."""
    mounted = rigs.EGO_FROM_LIDAR @ IMU.lidar_from_sensor
    before, here, after = (rigs.world_from_ego(IMU_NS + dt) @ mounted for dt in (-STEP_NS, 0, STEP_NS))
    moved = (after.translation_m - 2 * here.translation_m + before.translation_m) / (STEP_NS * 1e-9) ** 2
    return np.einsum("nji,nj->ni", here.rotation(), moved + np.array([0, 0, gravity_m_s2]))


def imu_messages(gravity_m_s2: float = 9.81, count: int | None = None) -> list[Recorded]:
    recorded = []
    for stamp_ns, force in list(zip(IMU_NS.tolist(), forces(gravity_m_s2), strict=True))[:count]:
        message = random_message("sensor_msgs/msg/Imu", np.random.default_rng(0), True)
        message.header = header(stamp_ns, "imu_link")
        for axis, value in zip("xyz", force.tolist(), strict=True):
            setattr(message.linear_acceleration, axis, value)
        recorded.append(Recorded("/imu/data", "sensor_msgs/msg/Imu", stamp_ns, serialised(message)))
    return recorded


def tilted() -> PoseTrack:
    """The true path in a frame that stands on a slope."""
    return PoseTrack(
        Trajectory(GRAVITY_ALIGNMENT_POSES_NS, SLOPE @ rigs.world_from_ego(GRAVITY_ALIGNMENT_POSES_NS)),
        "kiss-icp",
        "/points",
    )


def levelled_by(path: Path, messages: list[Recorded]) -> PoseTrack:
    with open_bag(written(path, messages)) as bag:
        return levelled(tilted(), imu_topic(bag, "/imu/data", IMU, rigs.EGO_FROM_LIDAR))


def tilt_off_deg(track: PoseTrack) -> np.ndarray:
    """Between the up of each pose and the true one, in the ego frame."""
    found, exact = (
        track.trajectory.map_from_ego.rotation()[:, 2],
        rigs.world_from_ego(GRAVITY_ALIGNMENT_POSES_NS).rotation()[:, 2],
    )
    return np.asarray(np.rad2deg(np.arccos(np.clip((found * exact).sum(axis=1), -1, 1))))


def test_a_drive_that_began_on_a_slope_is_turned_level_and_no_distance_changes(tmp_path):
    assert tilt_off_deg(tilted()).min() > 10
    track = levelled_by(tmp_path / "a.mcap", imu_messages())
    assert tilt_off_deg(track).max() < 0.25
    assert "turned by 16." in track.findings[0].message
    assert track.findings[0].severity == "info"
    track = levelled_by(tmp_path / "a.mcap", imu_messages())
    turn = track.trajectory.map_from_ego @ tilted().trajectory.map_from_ego.inverse()
    np.testing.assert_allclose(turn.wxyz, np.tile(turn.wxyz[0], (len(turn), 1)), atol=1e-9)
    assert turn.wxyz[0, 3] == pytest.approx(0.0, abs=1e-9)  # about no upright axis
    np.testing.assert_allclose(turn.translation_m, 0, atol=1e-9)


@pytest.mark.parametrize(
    "messages", [imu_messages(gravity_m_s2=1.0), imu_messages(count=LEAST_SAMPLES - 1)], ids=["in g", "too few samples"]
)
def test_what_is_no_gravity_turns_nothing_and_is_said(tmp_path, messages):
    track = levelled_by(tmp_path / "a.mcap", messages)
    assert track.trajectory is not None
    np.testing.assert_array_equal(track.trajectory.map_from_ego.wxyz_xyz, tilted().trajectory.map_from_ego.wxyz_xyz)
    assert [(f.code, f.severity) for f in track.findings] == [("SYN-506", "warning")]


def test_without_an_imu_nothing_is_turned():
    assert [f.severity for f in levelled(tilted(), None).findings] == ["warning"]
