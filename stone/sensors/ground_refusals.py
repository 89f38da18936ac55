"""Refusals of runs whose ground shows a wrong mount or wrong poses.

**Conventions.** In the ego frame of `stone/sensors/ground_plane.py`. Labelling and inspection use the same check, so
that inspection predicts refusals.
"""

import math

from stone.errors import Refused
from stone.sensors.calibration import Calibration, entry_of
from stone.sensors.driving_direction import turned_to_way
from stone.sensors.ground_plane import BAND_M, GroundFit, footprint_off_ground, is_off_ground
from stone.sensors.sequence import Sequence


def ground_refusal(sequence: Sequence, band_m: float = BAND_M) -> Refused | None:
    """Return the refusal of a run whose footprint (or one half of it) is off the ground, or whose LiDAR or poses tilt.

    Returns None otherwise, also without measured ground.

    The search band for driven ground is `band_m` metres around the footprint.
    """
    ground, footprint = sequence.ground, sequence.calibration.footprint
    if ground is None:
        return None
    # from the footprint's centre to the centre of its half
    lean_m = max(abs(ground.slope_x) * footprint.length_m, abs(ground.slope_y) * footprint.width_m) / 4
    if is_off_ground(ground, band_m) or lean_m > band_m:
        return footprint_off_ground(ground, sequence.calibration.ego_from_lidar, band_m)
    if ground.is_mount_tilted:
        return _mount_tilted(ground)
    return _poses_tilted(ground, sequence.calibration) if ground.is_way_tilted else None


def _mount_tilted(ground: GroundFit) -> Refused:
    return Refused(
        "footprint_off_ground",
        f"the ground tilts by {math.degrees(ground.tilt_rad):.1f}° in the ego frame, as do the sweeps in the "
        "map, so the LiDAR's mount differs from the calibration. Labels would be wrong: enter the values from "
        "CAL-433; ground auto corrects it for this run",
    )


def _poses_tilted(ground: GroundFit, calibration: Calibration) -> Refused:
    climb_rad = math.atan(ground.way_slope)
    mounts = turned_to_way(calibration, 0.0, climb_rad - math.atan(ground.slope_x))
    entries = [f"enter {entry_of(mount)}" for mount in mounts]
    way_out = entries[0] if entries else "correct the source, or estimate the poses from the sweeps (odometry kiss-icp)"
    return Refused(
        "poses_tilted",
        f"according to its poses, the robot drives {abs(math.degrees(climb_rad)):.1f}° "
        f"{('above' if climb_rad > 0 else 'below')} its heading, although the sweeps show level ground. The "
        "INS is rotated on its mount, its attitude is biased, or its heights drift. Labels would be wrong: "
        f"{way_out}",
    )
