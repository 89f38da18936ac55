"""Maps on two sides of a break are joined where one place fits and only there, and every break is told of."""

from dataclasses import replace

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.sensors.ego_path import maps_of_frames
from stone_recordings.bags.errors import CloudLayoutError
from stone_recordings.sync.map_joining import MOST_BREAKS, joined
from tests.services.labeler.worlds import RayCast, World, sequence_of

# Walls all around, so that every direction is held by something.
BOXES = (
    Box((1.5, 2.0, -0.5), (2.7, 3.2, 1.4)),
    Box((-4.0, -4.5, -0.5), (-2.5, -3.0, 1.6)),
    Box((4.0, -3.5, -0.5), (4.6, -1.0, 1.5)),
    Box((-3.5, 2.5, -0.5), (-3.0, 5.0, 1.2)),
)
WALLED = World(grade=(0.05, 0.02), boxes=BOXES, frames=16, step_m=0.2)
BARE = World(grade=(0.05, 0.02), frames=16, step_m=0.2)
EXACT = sequence_of(WALLED).frames.map_from_ego


def jumped(world, at=8, by=(30.0, 12.0, 1.5)):
    """The drive whose poses lie elsewhere from frame `at` on."""
    sequence = sequence_of(world)
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[at:, 4:] += by
    return replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)))


def errors_m(sequence):
    return np.linalg.norm(sequence.frames.map_from_ego.translation_m - EXACT.translation_m, axis=1)


def codes(sequence):
    return [(finding.code, finding.severity) for finding in sequence.findings]


@pytest.mark.parametrize("by", [(30.0, 12.0, 1.5), (0.0, 0.0, 2.0), (-1.5, 0.4, 0.0)])
def test_a_jump_is_taken_back_where_walls_hold_the_place(by):
    found = joined(jumped(WALLED, by=by), RayCast(WALLED))
    assert maps_of_frames(found).tolist() == [0] * 16
    assert errors_m(found).max() < 0.03
    assert codes(found) == [("SYN-507", "warning")]
    assert f"moved by {np.linalg.norm(by):.1f}"[:-1] in found.findings[0].message


def test_on_a_bare_plane_or_in_a_hundred_pieces_no_place_is_taken():
    given = jumped(BARE)
    found = joined(given, RayCast(BARE))
    assert maps_of_frames(found).tolist() == [0] * 8 + [1] * 8
    assert np.array_equal(found.frames.map_from_ego.wxyz_xyz, given.frames.map_from_ego.wxyz_xyz)
    assert codes(found) == [("SYN-508", "warning")]
    sequence = sequence_of(replace(BARE, frames=6 * MOST_BREAKS + 12))
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 6] += 7.0 * (np.arange(len(poses)) // 6)
    pieces = replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)))
    found = joined(pieces, RayCast(replace(BARE, breaks_at=0)))
    assert codes(found) == [("SYN-508", "warning")]


def test_what_was_seen_elsewhere_is_not_joined():
    other = replace(WALLED, boxes=tuple(Box(tuple(np.add(b.min_m, (0.9, -1.1, 0))), b.max_m) for b in BOXES[:2]))

    class Elsewhere:
        def sweep(self, index):
            return RayCast(WALLED if index < 8 else replace(other, grade=(-0.3, 0.2))).sweep(index)

    found = joined(jumped(WALLED), Elsewhere())
    assert maps_of_frames(found).tolist() == [0] * 8 + [1] * 8
    assert codes(found) == [("SYN-508", "warning")]


def test_two_breaks_are_joined_one_after_the_other_and_an_unbroken_track_is_left_alone():
    once = jumped(WALLED, 6, (30.0, 0, 0))
    poses = once.frames.map_from_ego.wxyz_xyz.copy()
    poses[11:, 4:] += (-3.0, 20.0, 0.5)
    found = joined(replace(once, frames=replace(once.frames, map_from_ego=SE3(poses))), RayCast(WALLED))
    assert errors_m(found).max() < 0.05
    assert codes(found) == [("SYN-507", "warning")] * 2
    sequence = sequence_of(WALLED)
    assert joined(sequence, RayCast(replace(WALLED, breaks_at=0))) is sequence


def test_where_nothing_was_seen_nothing_is_joined():
    class Blind:
        def sweep(self, index):
            if index == 3:
                raise CloudLayoutError("a lie")
            sweep = RayCast(WALLED).sweep(index)
            return sweep if index < 8 else replace(sweep, points_lidar=np.zeros((0, 3), np.float32))

    found = joined(jumped(WALLED), Blind())
    assert codes(found) == [("SYN-508", "warning")]
