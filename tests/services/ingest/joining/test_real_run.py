"""Two recordings of one KITTI drive: the whole at a reduced resolution, its first second in full."""

from pathlib import Path

from services.ingest.joining.clocks import JoinRequest, join_recordings
from stone_files.joined_file import SAME_MESSAGES

FILES = ("kitti0005_lidar_odom.mcap", "kitti0005_fullres_1s.mcap")
ODOMETRY_OF_A_SECOND = 12


def test_what_both_hold_tells_that_they_are_on_one_clock(field_data: Path) -> None:
    paths = tuple(field_data / "kitti0005_ros2_mcap" / name for name in FILES)
    reference, other = join_recordings(JoinRequest(paths)).members
    assert (other.known_by, other.offset_ns) == ((SAME_MESSAGES,), 0)
    left_out = reference.count_left_out() | other.count_left_out()
    assert (left_out["/odom"], left_out["/tf"]) == (ODOMETRY_OF_A_SECOND, ODOMETRY_OF_A_SECOND)
    assert "/velodyne_points" not in left_out
