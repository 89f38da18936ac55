"""Why a sequence cannot be labelled."""

from stone.errors import StoneError
from stone.sequence import Sequence


class NoFramesError(StoneError):
    """Every LiDAR stamp was excluded, or there was none."""

    code = "no_frames"

    def __init__(self, sequence: Sequence) -> None:
        codes = sorted({frame.code for frame in sequence.excluded})
        why = f"all {len(sequence.excluded)} were excluded ({', '.join(codes)})" if codes else "it has no LiDAR sweep"
        super().__init__(f"sequence {sequence.name} has no usable frame: {why}; do the poses cover the LiDAR's time?")
