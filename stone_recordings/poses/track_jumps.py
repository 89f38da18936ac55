"""Splits a track where its source jumped, with a finding: RTK lost or won moves positions by decimetres at once.

**Conventions.** Nothing is interpolated across a split; what is left of the track on either side stays where its source
put it, so a map across a split does not fit together.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.jumps import Jumps, jumps_of, split
from stone.geometry.trajectory import Trajectory
from stone.sensors.pose_quality import Rtk, SolutionQuality
from stone_recordings.poses.sources import PoseTrack

SHOWN = 3
MOST_STRAYS = 0.1


def split_at_jumps(track: PoseTrack) -> PoseTrack:
    """The track without poses that are alone off it, with a segment for each stretch without a jump."""
    track = without_strays(track)
    jumps = _jumps(track)
    if not len(jumps.steps):
        return track
    finding = Finding("GNS-302", "warning", track.topic, _sentence(track, jumps))
    return replace(track, trajectory=split(track.trajectory, jumps.steps), findings=(*track.findings, finding))


def without_strays(track: PoseTrack) -> PoseTrack:
    """Without single poses that the track jumps to and back from, where their neighbours fit; GNS-305 says so.

    Where they are more than a tenth of all, nothing tells which poses are right, and all stay.
    """
    jumps = _jumps(track)
    alone = jumps.steps[:-1][np.diff(jumps.steps) == 1] + 1
    if not len(alone) or len(alone) > MOST_STRAYS * len(track.trajectory):
        return track
    is_kept = np.ones(len(track.trajectory), np.bool_)
    is_kept[alone] = False
    rest = _rows(track, is_kept)
    still = np.flatnonzero(is_kept)[_jumps(rest).steps]
    is_kept[[one for one in alone.tolist() if is_kept[:one].any() and np.flatnonzero(is_kept[:one])[-1] in still]] = (
        True
    )
    if is_kept.all():
        return track
    excess_m = jumps.excess_m[np.isin(jumps.steps, np.flatnonzero(~is_kept) - 1)]
    stamp_ns = int(track.trajectory.stamps_ns[np.flatnonzero(~is_kept)[int(np.argmax(excess_m))]])
    sentence = (
        f"{int((~is_kept).sum())} single poses lie off the track that their neighbours are on and are left out "
        f"(worst {excess_m.max():.2f} m at {stamp_ns} ns)"
    )
    left = _rows(track, is_kept)
    return replace(left, findings=(*left.findings, Finding("GNS-305", "warning", track.topic, sentence)))


def _rows(track: PoseTrack, is_kept: NDArray[np.bool_]) -> PoseTrack:
    trajectory, solution = track.trajectory, track.solution
    return replace(
        track,
        trajectory=Trajectory(trajectory.stamps_ns[is_kept], trajectory.map_from_ego[is_kept]),
        solution=solution and SolutionQuality(solution.rtk[is_kept], solution.stdev_m[is_kept]),
    )


def _jumps(track: PoseTrack) -> Jumps:
    rtk = track.solution.rtk if track.solution is not None else None
    return jumps_of(track.trajectory, None if rtk is None else rtk[1:] != rtk[:-1])


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
