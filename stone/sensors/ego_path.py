"""The robot's own way through each map of a run: every pose of its track, never joined where the track breaks.

**Conventions.** A track breaks at jumps and gaps (`stone.geometry.segments`). What lies on two sides of a break is in
two maps, unless registration joined them (`Sequence.map_of_segment`); the way is not joined even then, for nobody knows
how the robot got across. Frames whose poses were refined take the track between them along: the correction of a pose
is interpolated between those of the frames around it, and is that of the nearest frame beyond them all.
"""

import numpy as np
from numpy.typing import NDArray

from stone.geometry.jumps import jumps_of, split
from stone.geometry.se3 import SE3, interpolate, steps_of
from stone.geometry.segments import segments_at
from stone.geometry.trajectory import Trajectory
from stone.sensors.sequence import Sequence

STEP_M = 0.05
STEP_RAD = 0.05


def track_of(sequence: Sequence) -> Trajectory:
    """The track of a sequence; frames that were made without one are theirs, split where they jump."""
    if sequence.track is not None:
        return sequence.track
    frames = Trajectory(sequence.frames.stamps_ns, sequence.frames.map_from_ego)
    return split(frames, jumps_of(frames).steps)


def maps_of_frames(sequence: Sequence) -> NDArray[np.int64]:
    """Which of the run's maps each frame (N,) is in, counted from 0."""
    if not len(sequence.frames):
        return np.zeros(0, np.int64)
    return _maps(sequence, segments_at(track_of(sequence), sequence.frames.stamps_ns))


def ego_path(sequence: Sequence, number: int) -> tuple[SE3, ...]:
    """The stretches of the robot's way in one map, poses at most `STEP_M` or `STEP_RAD` nearer than the track has them.

    A stretch without a frame is left out: in which map it lies, only a frame of it tells.
    """
    track, frames = track_of(sequence), sequence.frames
    segment_of_frame = segments_at(track, frames.stamps_ns)
    is_mine = _maps(sequence, segment_of_frame) == number
    segments = track.segments
    stretches = []
    for segment in np.unique(segment_of_frame[is_mine]).tolist():
        rows = np.flatnonzero(segments == segment)
        rows = rows[_kept(track.map_from_ego[rows])]
        stretch = Trajectory(track.stamps_ns[rows], track.map_from_ego[rows])
        stretches.append(_corrected(stretch, track, sequence, np.flatnonzero(segment_of_frame == segment)))
    return tuple(stretches)


def datum_m(sequence: Sequence, number: int) -> float:
    """How much higher the frames of one map are than those of the first that has any, on average, metres.

    Elevations of two maps that are not joined cannot be compared but by what was driven in each: a source that jumped
    jumped in height, too.
    """
    maps, heights_m = maps_of_frames(sequence), sequence.frames.map_from_ego.translation_m[:, 2]
    if number == maps[0]:
        return 0.0
    return float(heights_m[maps == number].mean() - heights_m[maps == maps[0]].mean())


def _maps(sequence: Sequence, segments: NDArray[np.int64]) -> NDArray[np.int64]:
    if not sequence.map_of_segment:
        return segments
    return np.asarray(np.array(sequence.map_of_segment, np.int64)[segments])


def _kept(poses: SE3) -> NDArray[np.int64]:
    """Rows of which none is left out but between two that are near each other; the first and the last are kept."""
    lengths_m, angles_rad = steps_of(poses)
    steps = np.floor(np.concatenate([[0.0], np.cumsum(lengths_m / STEP_M + angles_rad / STEP_RAD)]))
    is_kept = np.append(True, np.diff(steps) > 0)
    is_kept[-1] = True
    return np.flatnonzero(is_kept).astype(np.int64)


def _corrected(stretch: Trajectory, track: Trajectory, sequence: Sequence, rows: NDArray[np.int64]) -> SE3:
    """The stretch as the frames `rows` of its segment, which may have been moved, ask for."""
    frames = sequence.frames
    given = track.at(frames.stamps_ns[rows], sequence.max_pose_gap_ns).map_from_ego
    if np.array_equal(given.wxyz_xyz, frames.map_from_ego[rows].wxyz_xyz):
        return stretch.map_from_ego
    known = np.flatnonzero(np.isfinite(given.wxyz_xyz).all(axis=1))
    rows, given = rows[known], given[known]
    if not len(rows):
        return stretch.map_from_ego
    moves = frames.map_from_ego[rows] @ given.inverse()
    stamps_ns = frames.stamps_ns[rows]
    right = np.clip(np.searchsorted(stamps_ns, stretch.stamps_ns), 1, max(len(rows) - 1, 1))
    left, right = right - 1, np.minimum(right, len(rows) - 1)
    span_ns = np.maximum(stamps_ns[right] - stamps_ns[left], 1)
    ratio = np.clip((stretch.stamps_ns - stamps_ns[left]) / span_ns, 0.0, 1.0)
    return interpolate(moves[left], moves[right], ratio) @ stretch.map_from_ego
