"""The robot's path through each map of a run: every pose of its track, never joined across breaks.

**Conventions.** A track breaks at jumps and gaps (`stone.geometry.segments`). The two sides of a break are in two maps,
unless registration joined them (`Sequence.map_of_segment`). Even then the path is not joined, because the motion across
the break is unknown. The track follows refined frame poses: corrections are interpolated between the surrounding
frames, and beyond the frames the nearest frame's correction applies.
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
    """Return the track of a sequence; without a recorded track, the frames' poses, split at jumps."""
    if sequence.track is not None:
        return sequence.track
    frames = Trajectory(sequence.frames.stamps_ns, sequence.frames.map_from_ego)
    return split(frames, jumps_of(frames).steps)


def maps_of_frames(sequence: Sequence) -> NDArray[np.int64]:
    """Return the map of each frame (N,), counted from 0."""
    if not len(sequence.frames):
        return np.zeros(0, np.int64)
    return _maps(sequence, segments_at(track_of(sequence), sequence.frames.stamps_ns))


def ego_path(sequence: Sequence, number: int) -> tuple[SE3, ...]:
    """Return the stretches of the robot's path in one map, without poses within `STEP_M` and `STEP_RAD` of each other.

    A stretch without a frame is left out, because only frames determine its map.
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
    """Return the mean height of one map's frames above the first map's frames, in metres.

    Elevations of two unjoined maps can only be compared by the driven ground in each, because a source that jumps also
    jumps in height.
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
    """Return the kept rows: the first, the last, and all that are not near both neighbours."""
    lengths_m, angles_rad = steps_of(poses)
    steps = np.floor(np.concatenate([[0.0], np.cumsum(lengths_m / STEP_M + angles_rad / STEP_RAD)]))
    is_kept = np.append(True, np.diff(steps) > 0)
    is_kept[-1] = True
    return np.flatnonzero(is_kept).astype(np.int64)


def _corrected(stretch: Trajectory, track: Trajectory, sequence: Sequence, rows: NDArray[np.int64]) -> SE3:
    """Return the stretch, corrected to the (possibly moved) frames `rows` of its segment."""
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
