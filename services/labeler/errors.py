"""Errors of sequences that cannot be labelled."""

from stone.errors import Refused
from stone.sensors.sequence import Sequence


def no_usable_frames(sequence: Sequence) -> Refused:
    codes = sorted({frame.code for frame in sequence.excluded})
    why = f"all {len(sequence.excluded)} were excluded ({', '.join(codes)})" if codes else "it has no LiDAR sweep"
    return Refused(
        "no_frames", f"sequence {sequence.name} has no usable frame: {why}; do the poses cover the LiDAR's time?"
    )
