"""Drives (sequences that continue each other), and the distance in time and space between the tracks of two parts.

A sequence continues an earlier one if log and vehicle do not contradict and it starts at most `LONGEST_GAP_S` after the
earlier one ends. Its first pose must also be where the earlier track leads, within `SLACK_M` plus `STRETCH` times the
distance driven in the gap. Sequences that are linked in any number of steps are one drive. Their labels overlap at the
joints, and they share ground, weather and light.

**Conventions.** Places are (s, x, y, z): seconds after the first stamp, metres in `map`. Tracks with the same `map` are
comparable; '' is a map of that sequence only, such as its own odometry frame. Two sequences with the same first stamp
are never linked, because neither continues the other.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LONGEST_GAP_S = 10.0  # a robot of the dataset (2 m/s) is then still on the ground labelled by its last frame
CLOSE_PERIODS = 2.5
SLACK_M = 1.0
STRETCH = 1.5
SPACING_M = 2.0
MOST_PLACES = 128
MEASURED_M = 1.0

Places = tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True)
class DrivenTrack:
    """The times and places of a sequence's track: `period_ns` is the median frame period, `speed_m_s` is rarely
    exceeded.

    `places` has at least one place and includes the first and the last frame's. `log` and `vehicle` are '' if unstated.
    """

    log: str
    vehicle: str
    map: str
    first_ns: int
    last_ns: int
    period_ns: int
    speed_m_s: float
    places: Places


@dataclass(frozen=True)
class TrackOrigin:
    """The origin of a sequence's poses: log, vehicle and map, '' if unstated."""

    log: str = ""
    vehicle: str = ""
    map: str = ""


def driven_track(
    stamps_ns: NDArray[np.int64], positions_map: NDArray[np.float64], origin: TrackOrigin
) -> DrivenTrack | None:
    """Return the thinned track of frames at increasing stamps (N,) and positions (N, 3); None without frames."""
    if not len(stamps_ns):
        return None
    since_s = (stamps_ns - stamps_ns[0]) / 1e9
    steps_m, steps_s = np.linalg.norm(np.diff(positions_map, axis=0), axis=1), np.diff(since_s)
    way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    count = int(min(MOST_PLACES, 2 + way_m[-1] // SPACING_M))
    kept = np.unique(np.searchsorted(way_m, np.linspace(0.0, way_m[-1], count)))
    kept = np.unique([0, *kept.tolist(), len(stamps_ns) - 1])
    rows = np.column_stack([since_s, positions_map])[kept].round(3).tolist()
    return DrivenTrack(
        origin.log,
        origin.vehicle,
        origin.map,
        int(stamps_ns[0]),
        int(stamps_ns[-1]),
        int(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0,
        round(float(np.quantile(steps_m / steps_s, 0.95)), 3) if len(stamps_ns) > 1 else 0.0,
        tuple((s, x, y, z) for s, x, y, z in rows),
    )


def continues(earlier: DrivenTrack, later: DrivenTrack) -> bool:
    """Return whether `later` continues `earlier` or overlaps it in time, in the same drive."""
    gap_s = (later.first_ns - earlier.last_ns) / 1e9
    if earlier.first_ns >= later.first_ns or gap_s > LONGEST_GAP_S or earlier.map != later.map:
        return False
    if _contradict(earlier.log, later.log) or _contradict(earlier.vehicle, later.vehicle):
        return False
    if earlier.map:
        return _joins(earlier, later, gap_s)
    # Odometry restarts with each run of its driver, so poses that do not join contradict nothing.
    is_close = 0 < gap_s * 1e9 <= CLOSE_PERIODS * max(earlier.period_ns, later.period_ns)
    return bool(later.vehicle and earlier.vehicle) and gap_s > 0 and (is_close or _joins(earlier, later, gap_s))


def drives_of(tracks: Mapping[str, DrivenTrack]) -> dict[str, tuple[str, ...]]:
    """Return each sequence's drive by its id: the ids of the drive's sequences in the order of their first stamps."""
    order = sorted(tracks, key=lambda name: (tracks[name].first_ns, name))
    drive_of = {name: [name] for name in order}
    open_until_ns = int(LONGEST_GAP_S * 1e9)
    active = list[str]()
    for name in order:
        active = [other for other in active if tracks[other].last_ns + open_until_ns >= tracks[name].first_ns]
        for other in active:
            if drive_of[other] is not drive_of[name] and continues(tracks[other], tracks[name]):
                drive_of[other].extend(drive_of[name])
                drive_of |= dict.fromkeys(drive_of[name], drive_of[other])
        active.append(name)
    rank = {name: number for number, name in enumerate(order)}
    return {name: tuple(sorted(drive, key=rank.__getitem__)) for name, drive in drive_of.items()}


def _contradict(first: str, second: str) -> bool:
    return bool(first and second) and first != second


def _joins(earlier: DrivenTrack, later: DrivenTrack, gap_s: float) -> bool:
    """Return whether the earlier track leads to the later track's start, and the tracks agree if they overlap."""
    speed_m_s = max(earlier.speed_m_s, later.speed_m_s)
    if gap_s > 0:
        return _apart_m(earlier, later, later.first_ns) <= SLACK_M + STRETCH * speed_m_s * gap_s
    both_end_ns = min(earlier.last_ns, later.last_ns)
    return all(_apart_m(earlier, later, at) <= SLACK_M + SPACING_M for at in (later.first_ns, both_end_ns))


def _apart_m(first: DrivenTrack, second: DrivenTrack, at_ns: int) -> float:
    return float(np.linalg.norm(_place_at(first, at_ns) - _place_at(second, at_ns)))


def _place_at(track: DrivenTrack, at_ns: int) -> NDArray[np.float64]:
    """Return the pose at a time; outside the track the nearer end's."""
    rows = np.array(track.places)
    return np.array([np.interp((at_ns - track.first_ns) / 1e9, rows[:, 0], rows[:, axis]) for axis in (1, 2, 3)])


@dataclass(frozen=True)
class TrackGap:
    """The distance between two groups of sequences: the minimum distance of their tracks and the minimum time between
    them.

    `nearest` and `soonest` are the ids of the two closest sequences. None if no two sequences are comparable (same map
    for distance, tracks for time). `unknown` sequences have no track.
    """

    distance_m: float | None = None
    nearest: tuple[str, str] | None = None
    time_s: float | None = None
    soonest: tuple[str, str] | None = None
    unknown: int = 0


def gap_between(first: Mapping[str, DrivenTrack | None], second: Mapping[str, DrivenTrack | None]) -> TrackGap:
    """Return the gap between two groups; distances are exact to half of `MEASURED_M`, or of a long track's spacing."""
    known, others = ({key: track for key, track in of.items() if track} for of in (first, second))
    unknown = len(first) + len(second) - len(known) - len(others)
    distance_m, nearest = min(_distances(known, others), default=(None, None))
    time_s, soonest = _least_time(known, others)
    return TrackGap(distance_m, nearest, time_s, soonest, unknown)


def _distances(
    first: Mapping[str, DrivenTrack], second: Mapping[str, DrivenTrack]
) -> Iterator[tuple[float, tuple[str, str]]]:
    """Yield, for each map with tracks of both groups, the minimum distance and its two sequences."""
    maps = {track.map for track in first.values()} & {track.map for track in second.values()} - {""}
    if not maps:
        return
    from scipy.spatial import cKDTree  # a lazy import: it takes a third of a second

    for name in sorted(maps):
        (ids, points), (other_ids, other_points) = (_points(of, name) for of in (first, second))
        distances, places = cKDTree(points).query(other_points)
        least = int(distances.argmin())
        yield float(distances[least]), (ids[int(places[least])], other_ids[least])


def _points(tracks: Mapping[str, DrivenTrack], name: str) -> tuple[list[str], NDArray[np.float64]]:
    """Return points along the tracks in this map, `MEASURED_M` apart, and the sequence of each."""
    ids, points = list[str](), list[NDArray[np.float64]]()
    for sequence, track in tracks.items():
        if track.map != name:
            continue
        rows = np.array(track.places)[:, 1:]
        way_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1))])
        at_m = np.linspace(0.0, way_m[-1], 2 + int(way_m[-1] / MEASURED_M))
        points.append(np.column_stack([np.interp(at_m, way_m, rows[:, axis]) for axis in range(3)]))
        ids += [sequence] * len(at_m)
    return ids, np.concatenate(points)


def _least_time(
    first: Mapping[str, DrivenTrack], second: Mapping[str, DrivenTrack]
) -> tuple[float | None, tuple[str, str] | None]:
    """Return the minimum time in seconds (0 if two overlap in time), and its two sequences."""
    if not (first and second):
        return None, None
    begin, end = (np.array([getattr(track, name) for track in first.values()]) for name in ("first_ns", "last_ns"))
    others = [np.array([getattr(track, name) for track in second.values()]) for name in ("first_ns", "last_ns")]
    between_ns = np.maximum(np.maximum(others[0] - end[:, None], begin[:, None] - others[1]), 0)
    row, column = np.unravel_index(int(between_ns.argmin()), between_ns.shape)
    return float(between_ns[row, column]) / 1e9, (list(first)[row], list(second)[column])
