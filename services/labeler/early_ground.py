"""The ground under the robot from a few sweeps, before a recording is synchronised.

This check stops a run with an impossible mount at once instead of after minutes.
"""

from contextlib import suppress
from pathlib import Path

from services.labeler.parameters import LabelParameters
from stone.errors import Refused, StoneError
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.sync.ground_check import early_refusal
from stone_recordings.topics.sources import AskedTopics, choose_sources


def require_early_ground(bag: Path, calibration: Path, topics: AskedTopics, parameters: LabelParameters) -> None:
    """Raise `footprint_off_ground` if the ground is far off; synchronisation refuses all other faults."""
    refusal: Refused | None = None
    with suppress(StoneError), open_bag(bag) as opened:
        opened.believe()
        rig, _ = read_calibration(calibration, opened)
        lidar_topic = choose_sources(opened, topics).lidar.name
        refusal = early_refusal(opened, lidar_topic, rig, parameters.footprint_band_m)
    if refusal is not None:
        raise refusal
