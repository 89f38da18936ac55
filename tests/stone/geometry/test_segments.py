"""A track is numbered anew after each gap and each jump, and every time belongs to one stretch."""

import numpy as np

from stone.geometry.jumps import split
from stone.geometry.se3 import SE3
from stone.geometry.segments import segments_at, split_at_gaps
from stone.geometry.trajectory import PoseStatus, Trajectory

STAMPS_NS = np.array([0, 100, 200, 900, 1000, 1100], np.int64)
TRACK = Trajectory(STAMPS_NS, SE3.identity((6,)))


def test_a_gap_longer_than_the_limit_begins_a_segment_and_one_as_long_does_not():
    assert split_at_gaps(TRACK, 699).segments.tolist() == [0, 0, 0, 1, 1, 1]
    assert split_at_gaps(TRACK, 700) is TRACK


def test_gaps_and_jumps_are_numbered_together_in_time():
    jumped = split(TRACK, np.array([0, 4]))
    assert split_at_gaps(jumped, 300).segments.tolist() == [0, 1, 1, 2, 2, 3]


def test_a_time_belongs_to_the_stretch_of_the_last_pose_before_it_and_the_first_to_times_before_all():
    track = split_at_gaps(TRACK, 300)
    assert segments_at(track, np.array([-50, 0, 200, 899, 900, 5000])).tolist() == [0, 0, 0, 0, 1, 1]


def test_a_gap_is_still_called_a_gap_where_it_is_asked_for_a_pose():
    asked = np.array([500], np.int64)
    assert split_at_gaps(TRACK, 300).at(asked, 300).status.tolist() == [PoseStatus.GAP]
