"""Poses that disagree are drawn together, those that agree stay where they are, and either is said."""

import json
from dataclasses import replace

import numpy as np
import pytest

from services.labeler.local_run import LabelOptions, label
from services.labeler.map.refinement import refined
from services.labeler.parameters import LabelParameters, RefinementParameters
from stone.geometry.se3 import SE3, apart, multiply
from stone.sensors.calibration import Box
from stone_recordings.sync.sequence_file import read_sequence
from tests.services.labeler.worlds import RayCast, World, sequence_of

# Walls all around, so that every direction is held by something.
WORLD = World(
    grade=(0.05, 0.02),
    boxes=(
        Box((1.5, 2.0, -0.5), (2.7, 3.2, 1.4)),
        Box((-4.0, -4.5, -0.5), (-2.5, -3.0, 1.6)),
        Box((4.0, -3.5, -0.5), (4.6, -1.0, 1.5)),
        Box((-3.5, 2.5, -0.5), (-3.0, 5.0, 1.2)),
    ),
    frames=10,
    step_m=0.2,
)
PARAMETERS = LabelParameters(refinement=RefinementParameters())


def jittered(sequence, sigma_m=0.03, sigma_rad=0.004):
    """The sequence with independent noise on every pose but the first."""
    rng = np.random.default_rng(5)
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    turn = np.column_stack([np.ones(len(poses)), sigma_rad / 2 * rng.standard_normal((len(poses), 3))])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    poses[1:, 4:] += sigma_m * rng.standard_normal((len(poses) - 1, 3))
    poses[1:, :4] = multiply(turn[1:], poses[1:, :4])
    return moved(sequence, poses)


def moved(sequence, poses):
    return replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)))


def errors_m(sequence):
    """How far each pose is from where the robot was."""
    exact = sequence_of(WORLD).frames.map_from_ego.translation_m
    return np.linalg.norm(sequence.frames.map_from_ego.translation_m - exact, axis=1)


@pytest.fixture(scope="module")
def noisy():
    given = jittered(sequence_of(WORLD))
    return given, *refined(given, RayCast(WORLD), PARAMETERS)


def test_poses_that_jitter_come_together_and_the_map_gets_sharper(noisy):
    given, better, done = noisy
    assert np.median(errors_m(given)) > 0.03
    assert np.median(errors_m(better)) < 0.2 * np.median(errors_m(given))
    assert done.after.voxels < 0.9 * done.before.voxels
    assert done.after.thickness_m < 0.7 * done.before.thickness_m
    assert sum(done.kept.values()) == 0


def test_what_was_done_is_said_where_the_labels_are_read(noisy):
    given, better, done = noisy
    corrections = [
        apart(given.frames.map_from_ego[i], better.frames.map_from_ego[i]) for i in range(len(better.frames))
    ]
    assert done.correction_max_m == max(moved_m for moved_m, _ in corrections)
    assert done.correction_median_rad == np.median([turned_rad for _, turned_rad in corrections])
    assert better.pose_source == "odometry /odom, refined by small_gicp"
    assert [finding.code for finding in better.findings] == ["LAB-611"]
    assert str(done.after.voxels) in better.findings[0].message


def test_poses_that_agree_move_by_less_than_a_centimetre_and_the_first_not_at_all():
    exact = sequence_of(WORLD)
    same, done = refined(exact, RayCast(WORLD), PARAMETERS)
    np.testing.assert_array_equal(same.frames.map_from_ego[0].wxyz_xyz, exact.frames.map_from_ego[0].wxyz_xyz)
    assert done.correction_max_m < 0.01
    assert done.correction_max_rad < np.radians(0.2)
    assert done.after.voxels < 1.01 * done.before.voxels


def test_a_pose_beyond_the_limits_stays_as_given_and_is_counted():
    given = sequence_of(WORLD)
    poses = given.frames.map_from_ego.wxyz_xyz.copy()
    poses[5, 4] += 0.45
    better, done = refined(moved(given, poses), RayCast(WORLD), PARAMETERS)
    assert done.kept["beyond_limit"] == 1
    np.testing.assert_array_equal(better.frames.map_from_ego[5].wxyz_xyz, poses[5])
    assert [(finding.code, finding.severity) for finding in better.findings] == [
        ("LAB-611", "info"),
        ("LAB-612", "warning"),
    ]
    assert better.findings[1].message.startswith("1 of 10 ")


def test_a_sweep_that_saw_next_to_nothing_keeps_its_pose():
    blind = replace(WORLD, reach_m=0.6, boxes=(), frames=3)
    given = jittered(sequence_of(blind))
    better, done = refined(given, RayCast(blind), PARAMETERS)
    assert done.kept == {"too_little_seen": 3, "not_converged": 0, "beyond_limit": 0}
    np.testing.assert_array_equal(better.frames.map_from_ego.wxyz_xyz, given.frames.map_from_ego.wxyz_xyz)


@pytest.mark.whole
def test_labels_name_the_refinement_and_are_made_with_the_very_same_poses(noisy, tmp_path):
    given, better, done = noisy
    label(given, RayCast(WORLD), tmp_path / "out", LabelOptions(PARAMETERS))
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert record["refinement"] == json.loads(json.dumps(done.as_record()))
    assert record["parameters"]["refinement"]["method"] == "small_gicp"
    assert record["pose_source"] == better.pose_source
    assert "LAB-611" in {finding["code"] for finding in record["findings"]}
    made = read_sequence((tmp_path / "out" / "sequence.npz").read_bytes())
    np.testing.assert_array_equal(made.frames.map_from_ego.wxyz_xyz, better.frames.map_from_ego.wxyz_xyz)
