"""Why a sequence cannot be labelled."""

import math

from stone.errors import Refused
from stone.sensors.sequence import Sequence


def no_usable_frames(sequence: Sequence) -> Refused:
    codes = sorted({frame.code for frame in sequence.excluded})
    why = f"all {len(sequence.excluded)} were excluded ({', '.join(codes)})" if codes else "it has no LiDAR sweep"
    return Refused(
        "no_frames", f"sequence {sequence.name} has no usable frame: {why}; do the poses cover the LiDAR's time?"
    )


def footprint_off_ground(height_m: float, tilt_rad: float, band_m: float) -> Refused:
    where = "above" if height_m > 0 else "below"
    return Refused(
        "footprint_off_ground",
        f"the ground lies {abs(height_m):.2f} m {where} the ego origin and tilts by {math.degrees(tilt_rad):.1f}°, "
        f"and the footprint is swept within ±{band_m:g} m of it: is the LiDAR's mount in the calibration right, "
        "and the ego frame on the ground? "
        "CAL-433 says what to enter; ground auto corrects it for this run",
    )
