"""Why a sequence cannot be labelled."""

from stone.errors import StoneError
from stone.sensors.sequence import Sequence


class NoUsableFramesError(StoneError):
    """Every LiDAR stamp was excluded, or there was none."""

    code = "no_frames"

    def __init__(self, sequence: Sequence) -> None:
        codes = sorted({frame.code for frame in sequence.excluded})
        why = f"all {len(sequence.excluded)} were excluded ({', '.join(codes)})" if codes else "it has no LiDAR sweep"
        super().__init__(f"sequence {sequence.name} has no usable frame: {why}; do the poses cover the LiDAR's time?")


class WorkGoneError(StoneError):
    """What earlier stages left was removed; a run is kept for a week after it ended."""

    code = "work_gone"

    def __init__(self, name: str) -> None:
        super().__init__(f"{name} of this run is gone, so it cannot be continued; process the sequence again")
