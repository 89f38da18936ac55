"""Why a sequence cannot be labelled."""

import math

from stone.errors import Refused
from stone.sensors.calibration import Calibration, entry_of
from stone.sensors.driving_direction import turned_to_way
from stone.sensors.ground_plane import GroundFit
from stone.sensors.sequence import Sequence


def no_usable_frames(sequence: Sequence) -> Refused:
    codes = sorted({frame.code for frame in sequence.excluded})
    why = f"all {len(sequence.excluded)} were excluded ({', '.join(codes)})" if codes else "it has no LiDAR sweep"
    return Refused(
        "no_frames", f"sequence {sequence.name} has no usable frame: {why}; do the poses cover the LiDAR's time?"
    )


def mount_tilted(ground: GroundFit) -> Refused:
    return Refused(
        "footprint_off_ground",
        f"the ground tilts by {math.degrees(ground.tilt_rad):.1f}° in the ego frame, and the sweeps in the map with "
        "it: the LiDAR is not mounted as the calibration says, and labels would be wrong; "
        "CAL-433 says what to enter, and ground auto corrects it for this run",
    )


def poses_tilted(ground: GroundFit, calibration: Calibration) -> Refused:
    climb_rad = math.atan(ground.way_slope)
    mounts = turned_to_way(calibration, 0.0, climb_rad - math.atan(ground.slope_x))
    entries = [f"enter {entry_of(one)}" for one in mounts]
    way_out = entries[0] if entries else "correct the source, or take the poses from the sweeps (odometry kiss-icp)"
    return Refused(
        "poses_tilted",
        f"by its poses the robot drives {abs(math.degrees(climb_rad)):.1f}° {'above' if climb_rad > 0 else 'below'} "
        "where it faces, over ground that the sweeps show level with it: the INS is turned on its mount, its "
        f"attitude is biased, or its heights drift, and labels would be wrong: {way_out}",
    )
