"""Splits a track where its source jumped, with a finding: RTK lost or won moves positions by decimetres at once.

**Conventions.** Nothing is interpolated across a split; what is left of the track on either side stays where its source
put it, so a map across a split does not fit together.
"""

from dataclasses import replace

import numpy as np

from stone.findings import Finding
from stone.geometry.jumps import Jumps, jumps_of, split
from stone.sensors.pose_quality import Rtk, SolutionQuality
from stone_recordings.poses.sources import PoseTrack

SHOWN = 3


def split_at_jumps(track: PoseTrack) -> PoseTrack:
    """The track with a segment for each stretch without a jump."""
    rtk = track.solution.rtk if track.solution is not None else None
    jumps = jumps_of(track.trajectory, None if rtk is None else rtk[1:] != rtk[:-1])
    if not len(jumps.steps):
        return track
    finding = Finding("GNS-302", "warning", track.topic, _sentence(track, jumps))
    return replace(track, trajectory=split(track.trajectory, jumps.steps), findings=(*track.findings, finding))


def _sentence(track: PoseTrack, jumps: Jumps) -> str:
    worst = np.sort(np.argsort(-jumps.excess_m, kind="stable")[:SHOWN])
    shown = "; ".join(_one(track, int(jumps.steps[row]), float(jumps.excess_m[row])) for row in worst)
    count = len(jumps.steps)
    more = f" (and {count - SHOWN} smaller ones)" if count > SHOWN else ""
    return f"position jumps by {shown}{more}; the track is split there and never interpolated across"


def _one(track: PoseTrack, step: int, excess_m: float) -> str:
    stamp_ns = int(track.trajectory.stamps_ns[step + 1])
    return f"{excess_m:.2f} m at {stamp_ns} ns {_status(track.solution, step)}"


def _status(solution: SolutionQuality | None, step: int) -> str:
    if solution is None:
        return "without a known status"
    before, after = Rtk(int(solution.rtk[step])).word, Rtk(int(solution.rtk[step + 1])).word
    return f"while the status changed from {before} to {after}" if before != after else f"while the status was {after}"
