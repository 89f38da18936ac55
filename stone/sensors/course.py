"""Comparison of a track's heading with its course: an orientation that is not the robot's does not turn with its
course.

**Conventions.** The course is the direction of a step of at least `STEP_M` in plan; the heading is the direction of the
ego frame's x axis midway. Their difference is constant for a steering robot with any sensor mount, and constant except
for half a turn for a reversing robot. For a robot that moves sideways, course and heading differ, and position noise
has its own course. A doubt is therefore no proof; it marks a stretch to examine.
"""

from dataclasses import dataclass, replace
from math import hypot

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, multiply
from stone.geometry.trajectory import Trajectory

Array = NDArray[np.float64]
STEP_M, SMOOTHED = 0.8, 3
DOUBT_RAD, ENOUGH_RAD = float(np.deg2rad(15.0)), float(np.deg2rad(28.0))
ASIDE_RAD = float(np.deg2rad(20.0))
MOST_STEPS, LONGEST_NS = 60, 30_000_000_000
STILL_RAD, STILL_NS = float(np.deg2rad(1.0)), 6_000_000_000
MOST_DOUBTS = 3
STRAIGHT_STEPS, TICK_NS, BASE_M = 4, 50_000_000, 0.6


@dataclass(frozen=True)
class Doubt:
    """The stamps between which the heading does not turn with the course, or points elsewhere (`is_aside`)."""

    begin_ns: int
    end_ns: int
    course_rad: float
    is_aside: bool = False


@dataclass(frozen=True, eq=False)
class _Steps:
    """S steps: stamps of their ends (S, 2), unwrapped course (S,) and the course relative to the heading (S,)."""

    stamps_ns: NDArray[np.int64]
    course_rad: Array
    off_rad: Array


def doubts_of(track: Trajectory) -> list[Doubt]:
    """Return where a track's heading fits its course worst: at most `MOST_DOUBTS` per stretch, turns first; none if it
    fits or the track has no course.
    """
    doubts = [doubt for rows in _stretches(track) for doubt in _doubts(_steps(track, rows))]
    return sorted(doubts, key=lambda doubt: doubt.is_aside)[:MOST_DOUBTS]


def aside_of_course(track: Trajectory) -> float:
    """Return the median angle between heading and course in rad; π if the track has no course."""
    angles = [_steps(track, rows).off_rad for rows in _stretches(track)]
    off = np.concatenate([*angles, np.zeros(0)])
    return float(np.median(np.abs(np.angle(np.exp(1j * off))))) if len(off) else float(np.pi)


def headings_along(place_m: Array) -> Array:
    """Return the course (N,) at each of N places (N, 2 or 3) of a track, over `BASE_M` of it.

    If the robot stands, the nearest course is used; NaN if the track is shorter than `BASE_M`.
    """
    gone_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(place_m[:, :2], axis=0).T)))
    if gone_m[-1] <= BASE_M:
        return np.full(len(place_m), np.nan)
    at_m, half = np.clip(gone_m, BASE_M / 2, gone_m[-1] - BASE_M / 2), BASE_M / 2
    x, y = (np.interp(at_m + half, gone_m, axis) - np.interp(at_m - half, gone_m, axis) for axis in place_m[:, :2].T)
    course = np.unwrap(np.arctan2(y, x))
    first = int(np.searchsorted(gone_m, 2 * BASE_M))
    last = int(np.searchsorted(gone_m, gone_m[-1] - 2 * BASE_M, side="right")) - 1
    if (
        0 < first < len(course) and 0 <= last < len(course) - 1
    ):  # the course over an end equals the course of its middle
        begin = (course[first] - course[0]) / max(at_m[first] - at_m[0], BASE_M / 2)
        end = (course[-1] - course[last]) / max(at_m[-1] - at_m[last], BASE_M / 2)
        course = course + np.minimum(gone_m - at_m, 0.0) * begin + np.maximum(gone_m - at_m, 0.0) * end
    return np.asarray(course)


def _stretches(track: Trajectory) -> list[NDArray[np.int64]]:
    segments = track.segments
    return [np.flatnonzero(segments == segment) for segment in np.unique(segments).tolist()]


def doubt_of_still(track: Trajectory) -> Doubt | None:
    """Return the middle of a track that neither moves nor turns; None for any other."""
    poses = track.map_from_ego
    turned = multiply(poses.wxyz[0] * np.array([1.0, -1.0, -1.0, -1.0]), poses.wxyz)
    is_turning = 2 * np.arccos(np.clip(np.abs(turned[:, 0]).min(), 0.0, 1.0)) > STILL_RAD
    if is_turning or np.hypot(*np.ptp(poses.translation_m[:, :2], axis=0)) > 2 * STEP_M:
        return None
    middle_ns = int(track.stamps_ns[0] + track.stamps_ns[-1]) // 2
    return Doubt(middle_ns - STILL_NS // 2, middle_ns + STILL_NS // 2, 0.0)


def unturned(track: Trajectory) -> Trajectory:
    """Return the positions of a track without orientations; its doubt is at a turn."""
    places_m = track.map_from_ego.translation_m
    return replace(track, map_from_ego=SE3.from_parts(np.array([1.0, 0.0, 0.0, 0.0]), places_m))


def headings(poses: SE3) -> Array:
    """Return the yaw (N,) of each pose's x axis in plan."""
    forward = poses.rotation()[..., :, 0]
    return np.asarray(np.arctan2(forward[..., 1], forward[..., 0]))


def _steps(track: Trajectory, rows: NDArray[np.int64]) -> _Steps:
    rows = rows[np.unique((track.stamps_ns[rows] - track.stamps_ns[rows[0]]) // TICK_NS, return_index=True)[1]]
    place_m = track.map_from_ego.translation_m[rows, :2]
    x, y = place_m.T.tolist()
    marks = [0]
    for row in range(1, len(rows)):
        if hypot(x[row] - x[marks[-1]], y[row] - y[marks[-1]]) >= STEP_M:
            marks.append(row)
    at = np.array(marks, np.int64)
    begin, end = at[:-1], at[1:]
    way = place_m[end] - place_m[begin]
    course = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    heading = headings(track.map_from_ego[rows[(begin + end) // 2]])
    stamps_ns = track.stamps_ns[rows]
    return _Steps(np.stack([stamps_ns[begin], stamps_ns[end]], axis=-1), course, course - heading)


def _doubts(steps: _Steps) -> list[Doubt]:
    count = len(steps.off_rad)
    if count < 2:
        return []
    off = _smoothed(np.unwrap(steps.off_rad, period=np.pi))
    best, best_apart = np.zeros(0), 0
    for apart in range(1, min(MOST_STEPS, count - 1) + 1):
        change = np.abs(off[apart:] - off[:-apart])
        change[steps.stamps_ns[apart:, 1] - steps.stamps_ns[:-apart, 0] > LONGEST_NS] = 0.0
        if change.max() > max(DOUBT_RAD, best.max(initial=0.0)):
            best, best_apart = change, apart
        if best.max(initial=0.0) >= ENOUGH_RAD:
            break
    doubts = list[Doubt]()
    while len(doubts) < MOST_DOUBTS and best.max(initial=0.0) > DOUBT_RAD:
        at = int(np.argmax(best))
        doubts.append(_between(steps, at, at + best_apart))
        best[max(0, at - best_apart) : at + best_apart + 1] = 0.0
    aside = _aside(steps) if not doubts else None
    return doubts if aside is None else [aside]


def _aside(steps: _Steps) -> Doubt | None:
    """Return the straightest stretch of a track whose course differs from its heading throughout."""
    off = np.arctan2(np.sin(steps.off_rad), np.cos(steps.off_rad))
    if float(np.median(np.abs(off))) <= ASIDE_RAD:
        return None
    length = min(STRAIGHT_STEPS, len(off))
    bends = [float(np.ptp(steps.course_rad[at : at + length])) for at in range(len(off) - length + 1)]
    at = int(np.argmin(bends))
    stretch = _between(steps, at, at + length - 1)
    return Doubt(stretch.begin_ns, stretch.end_ns, float(off[at : at + length].mean()), is_aside=True)


def _between(steps: _Steps, first: int, last: int) -> Doubt:
    course_rad = float(steps.course_rad[last] - steps.course_rad[first])
    return Doubt(int(steps.stamps_ns[first, 0]), int(steps.stamps_ns[last, 1]), course_rad)


def _smoothed(values: Array) -> Array:
    """Return the running median of three, so that a single noisy step gives no doubt."""
    if len(values) < SMOOTHED:
        return values
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, 1, mode="edge"), SMOOTHED)
    return np.asarray(np.median(around, axis=-1))
