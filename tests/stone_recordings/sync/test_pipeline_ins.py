"""A NovAtel recording gives back the path it was made from: lever arm, attitude signs, GPS time, deskewed sweeps."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.sensors.calibration_errors import MissingSensorError
from stone.sensors.sequence import frame_token
from stone_recordings.sync.errors import NoPosedFramesError, NoUsablePoseError
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, calibration, ins_messages, written

SWEEPS_NS = T0_NS + 20_300_000 + np.arange(12) * PERIOD_NS
POSES_NS = T0_NS + np.arange(-2, 30) * 50_000_000


def synchronised(path: Path, cal=None, **options):
    return synchronise(path, cal or calibration(), SynchroniseOptions(**options), "run")


def expected_map_from_ego(stamps_ns, origin):
    """The true path, seen from the map's own origin."""
    east_north_up = np.array(pymap3d.geodetic2enu(*origin, *rigs.ORIGIN))
    truth = rigs.world_from_ego(stamps_ns)
    return truth.rotation(), truth.translation_m - east_north_up, east_north_up


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sweeps = [rigs.wall_sweep(int(stamp)) for stamp in SWEEPS_NS]
    return written(tmp_path_factory.mktemp("ins") / "drive.mcap", sweeps, ins_messages(POSES_NS))


def test_poses_are_the_true_ones_within_two_millimetres_and_the_lever_arm_turns_with_the_robot(drive):
    sequence, _ = synchronised(drive)
    frames = sequence.frames
    assert frames.stamps_ns.tolist() == SWEEPS_NS.tolist()
    assert sequence.excluded == ()
    rotation, place_m, _ = expected_map_from_ego(frames.stamps_ns, sequence.map_origin_deg_m)
    np.testing.assert_allclose(frames.map_from_ego.translation_m, place_m, atol=1.5e-3)
    np.testing.assert_allclose(frames.map_from_ego.rotation(), rotation, atol=2e-4)
    # The lever arm is a metre: not turned with the robot, it would miss by far more than the tolerance.
    lever = (rigs.EGO_FROM_LIDAR @ rigs.LIDAR_FROM_INS).translation_m
    assert np.linalg.norm(rotation @ lever - lever, axis=1).min() > 0.1


def test_the_origin_of_the_map_is_the_first_solution(drive):
    sequence, _ = synchronised(drive)
    first = rigs.world_from_ego(POSES_NS[:1]) @ rigs.EGO_FROM_LIDAR @ rigs.LIDAR_FROM_INS
    oracle = pymap3d.enu2geodetic(*first.translation_m[0], *rigs.ORIGIN)
    np.testing.assert_allclose(sequence.map_origin_deg_m, oracle, atol=1e-9)
    assert sequence.pose_source == "/novatel/oem7/inspvax (novatel_oem7_msgs/msg/INSPVAX)"


def test_deskewed_sweeps_lie_on_the_wall_and_raw_ones_do_not(drive):
    sequence, sweeps = synchronised(drive)
    raw = replace(sweeps, mount=None)
    _, _, shift_m = expected_map_from_ego(SWEEPS_NS, sequence.map_origin_deg_m)
    map_from_lidar = sequence.frames.map_from_ego @ rigs.EGO_FROM_LIDAR
    copy = pickle.loads(pickle.dumps(sweeps))
    worst_raw_m = 0.0
    for index in range(len(SWEEPS_NS)):
        sweep = copy.sweep(index)
        assert (sweep.stamp_ns, sweep.points_lidar.shape) == (SWEEPS_NS[index], (400, 3))
        wall = map_from_lidar[index] @ sweep.points_lidar.astype(np.float64) + shift_m
        np.testing.assert_allclose(wall[:, 1], rigs.WALL_Y_M, atol=6e-3)
        bent = map_from_lidar[index] @ raw.sweep(index).points_lidar.astype(np.float64) + shift_m
        worst_raw_m = max(worst_raw_m, float(np.abs(bent[:, 1] - rigs.WALL_Y_M).max()))
    assert worst_raw_m > 0.3


def test_host_stamps_are_said_and_not_used(drive):
    sequence, _ = synchronised(drive)
    assert [finding.code for finding in sequence.findings] == ["TIM-201", "CAL-435"]  # its sweeps show no ground
    assert "GPS time is used instead" in sequence.findings[0].message


def test_frames_are_named_by_sequence_and_stamp_and_the_recording_by_its_hash(drive):
    sequence, _ = synchronised(drive)
    assert sequence.frames.tokens[3] == frame_token("run", int(SWEEPS_NS[3]))
    assert len(sequence.inputs["drive.mcap"]) == 64


def test_sweeps_without_a_pose_are_excluded_each_with_its_reason(tmp_path):
    poses_ns = np.delete(POSES_NS, np.arange(12, 18))[4:20]
    path = written(tmp_path / "a.mcap", [rigs.wall_sweep(int(s)) for s in SWEEPS_NS], ins_messages(poses_ns))
    sequence, sweeps = synchronised(path)
    reasons = {int((e.stamp_ns - SWEEPS_NS[0]) // PERIOD_NS): (e.code, e.reason) for e in sequence.excluded}
    assert reasons[0] == ("no_pose_before_first", "the stamp lies before the first pose")
    assert reasons[4] == ("pose_gap", "the sweep's last point lies in a gap of 350.0 ms between two poses")
    assert reasons[5][0] == "pose_gap"
    assert reasons[11] == ("no_pose_after_last", "the sweep's last point lies after the last pose")
    assert len(sequence.frames) + len(reasons) == len(SWEEPS_NS)
    assert "SYN-501" in [finding.code for finding in sequence.findings]
    assert all(len(sweeps.sweep(i).points_lidar) == 400 for i in range(len(sequence.frames)))
    bridged, _ = synchronised(path, max_pose_gap_ns=350_000_000)
    assert "pose_gap" not in {e.code for e in bridged.excluded}


def test_a_recording_on_two_clocks_is_refused_with_their_distance(tmp_path):
    late = [rigs.wall_sweep(int(stamp)) for stamp in SWEEPS_NS + 37_000_000_000]
    path = written(tmp_path / "a.mcap", late, ins_messages(POSES_NS))
    with pytest.raises(NoPosedFramesError, match=r"12 no_pose_after_last.*\+37\.120 s apart at the start"):
        synchronised(path)


@pytest.mark.parametrize(("facts", "why"), [({"ins_status": 1}, "32 without an aligned solution")])
def test_an_ins_that_never_aligned_is_refused(tmp_path, facts, why):
    path = written(tmp_path / "a.mcap", [rigs.wall_sweep(int(SWEEPS_NS[0]))], ins_messages(POSES_NS, **facts))
    with pytest.raises(NoUsablePoseError, match=f"none of its 32 samples is usable .{why}"):
        synchronised(path)


def test_samples_without_a_solution_are_left_out_and_said(tmp_path):
    unaligned = ins_messages(POSES_NS[:4], ins_status=1)
    path = written(
        tmp_path / "a.mcap", [rigs.wall_sweep(int(s)) for s in SWEEPS_NS], unaligned + ins_messages(POSES_NS[4:])
    )
    sequence, _ = synchronised(path)
    assert "4 of 32 samples had no solution" in " ".join(f.message for f in sequence.findings)
    assert sequence.excluded[0].code == "no_pose_before_first"


def test_rtk_that_was_not_fixed_is_said(tmp_path):
    path = written(
        tmp_path / "a.mcap", [rigs.wall_sweep(int(s)) for s in SWEEPS_NS], ins_messages(POSES_NS, pos_type=55)
    )
    sequence, _ = synchronised(path)
    assert "RTK was fixed only 0.0 % of the time (100.0 % float)" in [f.message for f in sequence.findings]


def test_an_ins_without_a_mount_is_refused(drive):
    without = replace(calibration(), mounts=rigs.MOUNTS[1:])
    with pytest.raises(MissingSensorError, match="the calibration has no INS, which the recorded INS pose needs"):
        synchronised(drive, without)


def test_the_clock_offset_of_the_calibration_moves_the_poses_in_time(drive):
    ins = replace(rigs.MOUNTS[0], time_offset_ns=-10_000_000)
    sequence, _ = synchronised(drive, calibration(ins))
    _, place_m, _ = expected_map_from_ego(sequence.frames.stamps_ns + 10_000_000, sequence.map_origin_deg_m)
    np.testing.assert_allclose(sequence.frames.map_from_ego.translation_m, place_m, atol=2e-3)
