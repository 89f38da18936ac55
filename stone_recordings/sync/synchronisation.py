"""Frames at the LiDAR's stamps: their poses with their quality, and each excluded sweep with its reason.

**Conventions.** A frame needs a pose at its stamp and, if points carry times, over its whole sweep, all on one unbroken
stretch of the track. Poses are never extrapolated, nor interpolated across a jump.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.segments import split_at_gaps
from stone.geometry.smooth_interpolation import with_between
from stone.geometry.trajectory import Interpolated, PoseStatus, Trajectory
from stone.sensors.association import typical_period_ns
from stone.sensors.pose_quality import quality_at, unknown_quality
from stone.sensors.sequence import Association, ExcludedFrame, Frames, frame_token
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.poses.sources import PoseTrack
from stone_recordings.sync.errors import NoUsablePoseError, no_posed_frames

EXCLUSIONS = {
    PoseStatus.BEFORE_FIRST: "no_pose_before_first",
    PoseStatus.AFTER_LAST: "no_pose_after_last",
    PoseStatus.GAP: "pose_gap",
    PoseStatus.SPLIT: "pose_jump",
}


@dataclass(frozen=True, eq=False)
class PosedFrames:
    """Frames without their other sensors, and the `path` of their poses; `period_ns` is that of all sweeps.

    `message_index` (N,) is that of each frame's sweep in its topic.
    """

    frames: Frames
    path: Trajectory
    period_ns: int
    message_index: NDArray[np.int64]
    excluded: tuple[ExcludedFrame, ...]


def frames_with_pose(
    name: str, clock: LidarClock, track: PoseTrack, max_gap_ns: int, way_out: Callable[[], str] = lambda: ""
) -> PosedFrames:
    """Return every LiDAR stamp, as a frame or as an exclusion with its reason.

    `way_out` returns how to bring the two clocks together, for a refusal.

    Raises, if no stamp has a pose, NoUsablePoseError (a single pose), `SYN-511` or `SYN-501`.
    """
    stamps_ns, trajectory = clock.ordered.stamps_ns, track.trajectory
    if len(trajectory) < 2:
        raise NoUsablePoseError(track.source, len(trajectory), "one pose is not a track")
    path = split_at_gaps(with_between(trajectory, max_gap_ns) if track.is_smooth else trajectory, max_gap_ns)
    at_stamp = path.at(stamps_ns, max_gap_ns)
    at_ends = [path.at(stamps_ns + offset_ns, max_gap_ns) for offset_ns in clock.span_ns]
    is_empty = clock.points == 0
    is_broken = (at_ends[0].segment != at_stamp.segment) | (at_ends[1].segment != at_stamp.segment)
    is_usable = at_stamp.is_ok & at_ends[0].is_ok & at_ends[1].is_ok & ~is_empty & ~is_broken
    rows = np.flatnonzero(is_usable)
    unposed = (
        _exclusion(int(stamps_ns[row]), bool(is_empty[row]), [_found_at(each, row) for each in (at_stamp, *at_ends)])
        for row in np.flatnonzero(~is_usable).tolist()
    )
    excluded = tuple(sorted((*clock.excluded, *unposed), key=lambda each: each.stamp_ns))
    if not len(rows):
        if sparse_finding(track, max_gap_ns):
            raise Refused(
                "SYN-511",
                f"{track.source}: its poses come every "
                f"{typical_period_ns(trajectory.stamps_ns) / 1e9:.3f} s, but interpolation "
                f"spans at most {max_gap_ns / 1e9:.3f} s, so no sweep has a pose. Record poses at a "
                "higher rate, or estimate them from the sweeps: --odometry kiss-icp",
            )
        raise no_posed_frames(counted_reasons(excluded), _seconds(stamps_ns), _seconds(trajectory.stamps_ns), way_out())
    frames = Frames(
        stamps_ns[rows],
        tuple(frame_token(name, stamp_ns) for stamp_ns in stamps_ns[rows].tolist()),
        at_stamp.map_from_ego[rows],
        quality=quality_at(trajectory, track.solution or unknown_quality(len(trajectory)), stamps_ns[rows]),
        sweeps=Association(clock.topic, clock.ordered.index[rows], np.zeros(len(rows), np.int64)),
    )
    return PosedFrames(frames, path, typical_period_ns(stamps_ns), clock.ordered.index[rows], excluded)


def sparse_finding(track: PoseTrack, max_gap_ns: int) -> tuple[Finding, ...]:
    """Return SYN-511 if poses are farther apart than the limit of interpolation."""
    period_ns = typical_period_ns(track.trajectory.stamps_ns)
    if period_ns <= max_gap_ns:
        return ()
    sentence = (
        f"its poses come every {period_ns / 1e9:.3f} s, but interpolation spans at most "
        f"{max_gap_ns / 1e9:.3f} s: only sweeps at a pose are frames"
    )
    return (Finding("SYN-511", "warning", track.topic, sentence),)


def usable_finding(posed: PosedFrames) -> tuple[Finding, ...]:
    """Return the number of sweeps that are frames, unless all are."""
    if not posed.excluded:
        return ()
    total = len(posed.frames) + len(posed.excluded)
    sentence = f"{len(posed.frames)} of {total} sweeps are frames; excluded: {counted_reasons(posed.excluded)}"
    return (Finding("SYN-501", "warning", "", sentence),)


def counted_reasons(excluded: tuple[ExcludedFrame, ...]) -> str:
    """Return the counts by reason, such as "3 no_pose_after_last, 1 pose_gap"."""
    counts = Counter(frame.code for frame in excluded)
    return ", ".join(f"{count} {code}" for code, count in sorted(counts.items()))


def _found_at(interpolated: Interpolated, row: int) -> tuple[PoseStatus, int]:
    return PoseStatus(int(interpolated.status[row])), int(interpolated.gap_ns[row])


def _seconds(stamps_ns: NDArray[np.int64]) -> tuple[float, float]:
    return int(stamps_ns[0]) / 1e9, int(stamps_ns[-1]) / 1e9


def _exclusion(stamp_ns: int, is_empty: bool, poses: list[tuple[PoseStatus, int]]) -> ExcludedFrame:
    if is_empty:
        return ExcludedFrame(stamp_ns, "empty_sweep", "the sweep has no points")
    is_missing = [status != PoseStatus.OK for status, _ in poses]
    if not any(is_missing):
        return ExcludedFrame(stamp_ns, EXCLUSIONS[PoseStatus.SPLIT], "the track breaks off during the sweep")
    status, gap_ns = poses[is_missing.index(True)]
    when = ("the stamp", "the sweep's first point", "the sweep's last point")[is_missing.index(True)]
    where = {
        PoseStatus.GAP: f"in a gap of {gap_ns / 1e6:.1f} ms between two poses",
        PoseStatus.SPLIT: "at a jump of the track",
        PoseStatus.BEFORE_FIRST: "before the first pose",
        PoseStatus.AFTER_LAST: "after the last pose",
    }
    return ExcludedFrame(stamp_ns, EXCLUSIONS[status], f"{when} lies {where[status]}")
