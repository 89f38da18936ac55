"""Why a sequence cannot be labelled."""

import math

from stone.errors import StoneError
from stone.sensors.sequence import Sequence


class NoUsableFramesError(StoneError):
    """Every LiDAR stamp was excluded, or there was none."""

    code = "no_frames"

    def __init__(self, sequence: Sequence) -> None:
        codes = sorted({frame.code for frame in sequence.excluded})
        why = f"all {len(sequence.excluded)} were excluded ({', '.join(codes)})" if codes else "it has no LiDAR sweep"
        super().__init__(f"sequence {sequence.name} has no usable frame: {why}; do the poses cover the LiDAR's time?")


class FootprintOffGroundError(StoneError):
    """The ground does not lie where the robot's footprint is swept, so what was driven on would not be found."""

    code = "footprint_off_ground"

    def __init__(self, height_m: float, tilt_rad: float, band_m: float) -> None:
        where = "above" if height_m > 0 else "below"
        super().__init__(
            f"the ground lies {abs(height_m):.2f} m {where} the ego origin and tilts by {math.degrees(tilt_rad):.1f}°, "
            f"and the footprint is swept within ±{band_m:g} m of it: is the LiDAR's mount in the calibration right, "
            "and the ego frame on the ground? "
            "CAL-433 says what to enter; ground auto corrects it for this run"
        )
