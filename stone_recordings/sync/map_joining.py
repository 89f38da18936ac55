"""Joining of the maps of a run whose track breaks: sweeps after a break are registered to sweeps before it.

**Conventions.** Registration starts twice: from the poses as given, which is right if the source paused, and from the
robot's motion before the break, which is right if the source jumped. If neither result is accepted
(`stone_recordings.sync.registration`), the frames after the break form a separate map. A correction moves all poses
from the break to the next one; below `TAKEN_M` and `TAKEN_RAD` poses stay as given. Findings report every break.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3, apart, interpolate
from stone.geometry.segments import segments_at
from stone.geometry.trajectory import Trajectory
from stone.sensors.ego_path import track_of
from stone.sensors.sequence import Sequence, SweepSource
from stone_recordings.sync.ground_looks import seen_around
from stone_recordings.sync.registration import Registered, Target, Trust

FRAMES_EACH_SIDE = 10
REACH_M, SAMPLING_M = 40.0, 0.3
VELOCITY_S, CONTINUED_S = 0.5, 10.0
TAKEN_M, TAKEN_RAD = 0.05, 0.005
MOST_BREAKS = 50


@dataclass(frozen=True, eq=False)
class Break:
    """A break between two successive frames in different segments; `registered` is the second pose from the first.

    `far_m` and `turned_rad` are its distance from the poses as given.
    """

    before: int
    after: int
    registered: Registered
    far_m: float
    turned_rad: float

    @property
    def is_joined(self) -> bool:
        return not self.registered.doubt

    @property
    def is_moved(self) -> bool:
        """Whether the registered pose is too far from the given one for the poses to stay."""
        return self.far_m > TAKEN_M or self.turned_rad > TAKEN_RAD


def joined(sequence: Sequence, sweeps: SweepSource) -> Sequence:
    """Return the sequence with its maps joined if registration can; the sequence itself if its track never breaks."""
    track, frames = track_of(sequence), sequence.frames
    segment_of_frame = segments_at(track, frames.stamps_ns)
    ends = np.flatnonzero(np.diff(segment_of_frame)).tolist()
    if not ends:
        return sequence
    if len(ends) > MOST_BREAKS:
        return replace(sequence, findings=(*sequence.findings, _too_many(len(ends))))
    pieces = _Pieces(sequence, sweeps, segment_of_frame)
    breaks = [pieces.registered(end, track) for end in ends]
    return _moved(sequence, track, segment_of_frame, breaks)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """The stretches of frames between breaks, and the points at their ends."""

    sequence: Sequence
    sweeps: SweepSource
    segment_of_frame: NDArray[np.int64]

    def registered(self, end: int, track: Trajectory) -> Break:
        """Return the break after the frame `end`, registered by the points on both sides."""
        poses = self.sequence.frames.map_from_ego
        given = poses[end].inverse() @ poses[end + 1]
        first = max(end - FRAMES_EACH_SIDE + 1, int(np.searchsorted(self.segment_of_frame, self.segment_of_frame[end])))
        last = int(np.searchsorted(self.segment_of_frame, self.segment_of_frame[end + 1], side="right"))
        target = Target(self._seen(range(first, end + 1), poses[end]), SAMPLING_M)
        source = self._seen(range(end + 1, min(end + 1 + FRAMES_EACH_SIDE, last)), poses[end + 1])
        starts = [given, *self._continued(end, track)]
        results = [target.register(source, start, Trust()) for start in starts]
        believed = [result for result in results if not result.doubt]
        best = (
            min(believed, key=lambda result: result.residual_m)
            if believed
            else max(results, key=lambda result: result.overlap)
        )
        return Break(end, end + 1, best, *apart(given, best.target_from_source))

    def _seen(self, indices: Listing[int], map_from_ego: SE3) -> NDArray[np.float64]:
        """Return the points (N, 3) of these frames, seen from this pose."""
        poses, clouds = self.sequence.frames.map_from_ego, []
        for index in indices:
            points = seen_around(self.sequence, self.sweeps, index)
            near = points[np.einsum("ij,ij->i", points, points) < REACH_M**2].astype(np.float64)
            clouds.append((map_from_ego.inverse() @ poses[index]) @ near)
        seen = np.concatenate(clouds)
        return np.asarray(seen[np.abs(seen).max(axis=1, initial=0.0) < 2 * REACH_M])

    def _continued(self, end: int, track: Trajectory) -> list[SE3]:
        """Return the robot's pose after the break if it kept its velocity of the last half second; empty if unknown."""
        stamps_ns, poses = self.sequence.frames.stamps_ns, self.sequence.frames.map_from_ego
        is_before = (track.segments == self.segment_of_frame[end]) & (track.stamps_ns <= stamps_ns[end])
        since_ns = int(stamps_ns[end]) - int(VELOCITY_S * 1e9)
        rows = np.flatnonzero(is_before & (track.stamps_ns >= since_ns))
        silent_ns = int(stamps_ns[end + 1] - stamps_ns[end])
        if not len(rows) or track.stamps_ns[rows[0]] == stamps_ns[end] or silent_ns > CONTINUED_S * 1e9:
            return []
        went = track.map_from_ego[int(rows[0])].inverse() @ poses[end]
        whole, rest = divmod(silent_ns / int(stamps_ns[end] - track.stamps_ns[rows[0]]), 1.0)
        way = interpolate(SE3.identity(), went, np.array(rest))
        for _ in range(int(whole)):
            way = went @ way
        return [way]


def _moved(
    sequence: Sequence, track: Trajectory, segment_of_frame: NDArray[np.int64], breaks: Listing[Break]
) -> Sequence:
    """Return the sequence with the frames after each break moved to their registered place."""
    segments, frames = track.segments, sequence.frames
    maps, moves = _maps_and_moves(sequence, segment_of_frame, breaks, int(segments[-1]) + 1)
    path = replace(track, map_from_ego=SE3(moves)[segments] @ track.map_from_ego)
    placed = replace(frames, map_from_ego=SE3(moves)[segment_of_frame] @ frames.map_from_ego)
    findings = (*sequence.findings, *(_finding(sequence, gap) for gap in breaks))
    recorded = path if sequence.track is not None else None
    return replace(sequence, frames=placed, track=recorded, map_of_segment=maps, findings=findings)


def _maps_and_moves(
    sequence: Sequence, segment_of_frame: NDArray[np.int64], breaks: Listing[Break], count: int
) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Return per segment its map and the transform before its poses (S, 7); a segment without frames follows the last
    one.
    """
    poses = sequence.frames.map_from_ego
    moves = SE3.identity((count,)).wxyz_xyz
    maps, number = [0] * count, 0
    follows = {int(segment_of_frame[gap.after]): gap for gap in breaks}
    move = SE3.identity()
    for segment in range(count):
        if (gap := follows.get(segment)) is not None:
            number += not gap.is_joined
            move = _move(poses, gap, move) if gap.is_joined else SE3.identity()
        maps[segment], moves[segment] = number, move.wxyz_xyz
    return tuple(maps), moves


def _move(poses: SE3, gap: Break, before: SE3) -> SE3:
    """Return the transform before the poses after a break, given the transform before the poses preceding it."""
    if not gap.is_moved:
        return before
    return before @ poses[gap.before] @ gap.registered.target_from_source @ poses[gap.after].inverse()


def _finding(sequence: Sequence, gap: Break) -> Finding:
    stamps_ns = sequence.frames.stamps_ns
    silent_s = (int(stamps_ns[gap.after]) - int(stamps_ns[gap.before])) * 1e-9
    where = f"the track breaks between {stamps_ns[gap.before]} and {stamps_ns[gap.after]} ns ({silent_s:.1f} s)"
    result = gap.registered
    if not gap.is_joined:
        sentence = f"{where}. The part after it is a separate map, because it cannot be joined: {result.doubt}"
        return Finding("SYN-508", "warning", "", sentence)
    moved = f"moved by {gap.far_m:.2f} m and {np.rad2deg(gap.turned_rad):.1f}°" if gap.is_moved else "as given"
    fits = f"{result.overlap:.0%} overlap, surfaces {1000 * result.residual_m:.0f} mm apart"
    return Finding("SYN-507", "warning" if gap.is_moved else "info", "", f"{where} and is joined {moved} ({fits})")


def _too_many(breaks: int) -> Finding:
    sentence = (
        f"the track breaks {breaks} times. Each stretch is a separate map, because above {MOST_BREAKS} breaks none are "
        "joined. Check the source of poses"
    )
    return Finding("SYN-508", "warning", "", sentence)
