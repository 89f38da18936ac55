"""The clock of a topic's points: whether it is that of its headers, and otherwise the distance of the two.

**Conventions.** Most sweeps are read individually (`stone_recordings.messages.point_times`). If points are on another
clock, sweeps are read by the distance of the two clocks, on which a few sweeps from beginning to end must agree. No
point is published before it is measured. So if the recorder has a sweep sooner after its stamp than a sweep lasts, the
stamp is that of its last point, else that of its first. The open recording keeps the result of a topic.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.lidar import LidarPoints
from stone_recordings.messages.point_times import (
    ANOTHER_CLOCK,
    HOUR_NS,
    NS_PER_S,
    PointClock,
    apart_ns,
    core_of,
    reach_of,
    span,
    time_names,
    units_of,
)
from stone_recordings.messages.pointcloud2 import Cloud, lidar_points
from stone_recordings.messages.sweep_clouds import cloud_at

# The first and the last sweep may be cut short; some from beginning to end show the true length.
SWEEP_SAMPLES = 16
LEAST_SWEEPS = 4
SPARSE = 16  # the step of the points that locate a sweep
# Sweeps of one clock start within a part of a sweep of each other; nine of ten do so.
AGREEING_SWEEPS, LEAST_AGREEING = 0.25, 0.9
# If the recorder has a sweep within this share of its length after its stamp, the stamp is that of its end.
LATE_SWEEPS, LAST_LATE_NS = 0.75, 1_000_000_000
# Quartzes differ by less; over a shorter time a slope is the jitter of stamps.
MOST_DRIFT, LEAST_DRIFTING_NS = 2e-4, 60_000_000_000
# This near to the start of a clock (a simulated one, or one of hours) times may be relative or absolute.
CERTAIN_NS = 1_500_000_000


@dataclass(frozen=True)
class SweepLook:
    """The timing of one sweep's points; `span_ns` is that of the times of `count` returns, None without."""

    row: int
    count: int
    meaning: str
    span_ns: tuple[int, int] | None
    wrapped: int
    filled: int
    untimed: int
    ignored: str
    is_swapped: bool


class _Ends(NamedTuple):
    """First and last time of a sweep on its points' clock, and the units that fit these times."""

    stamp_ns: int
    late_ns: int
    first_ns: int
    last_ns: int
    word_ns: int


class _Kept(NamedTuple):
    clocks: dict[str, tuple[PointClock | None, str]]
    looks: dict[tuple[str, int], SweepLook | None]


_KEPT: WeakKeyDictionary[Bag, _Kept] = WeakKeyDictionary()


def points_at(bag: Bag, topic: str, row: int, *, with_ring: bool = True) -> LidarPoints:
    """Return the returns of one message of a LiDAR's topic. Raises as `cloud_at`."""
    return points_in(bag, topic, cloud_at(bag, topic, row), with_ring=with_ring)


def points_in(bag: Bag, topic: str, cloud: Cloud, *, with_ring: bool = True) -> LidarPoints:
    """Return the returns of a cloud of a topic, timed by the clock of the topic's points."""
    points = lidar_points(cloud, with_ring=with_ring)
    is_relative = points.offset_ns is not None and points.time_meaning.startswith("relative")
    is_plain = not points.wrapped and _is_certain(cloud.stamp_ns) and _touches_stamp(points.offset_ns)
    is_doubtful = is_relative and not is_plain
    if points.time_meaning != ANOTHER_CLOCK and not is_doubtful:
        return points
    clock, _at = point_clock(bag, topic)
    return points if clock is None else lidar_points(cloud, with_ring=with_ring, clock=clock)


def point_clock(bag: Bag, topic: str) -> tuple[PointClock | None, str]:
    """Return the clock of a topic's points if it is required, and the point to which stamps belong: "first" or "last".

    None if sweeps do not agree on one, or if each can be read individually.
    """
    kept = _kept(bag)
    if topic not in kept.clocks:
        kept.clocks[topic] = _clock_of(list(_ends(bag, topic)))
    return kept.clocks[topic]


def _is_certain(stamp_ns: int) -> bool:
    """Return whether times near 0 at this stamp are relative: no clock, and no clock of hours, has just started."""
    return not stamp_ns or min(stamp_ns % HOUR_NS, -stamp_ns % HOUR_NS) >= CERTAIN_NS


def _touches_stamp(offset_ns: NDArray[np.int64] | None) -> bool:
    """Return whether the stamp lies within a sweep or next to it, as it does if its times are relative."""
    if offset_ns is None or not len(offset_ns):
        return True
    some = offset_ns[::SPARSE]
    first, last = int(some.min()), int(some.max())
    margin = (last - first) * AGREEING_SWEEPS
    return first - margin <= 0 <= last + margin


def looks_of(bag: Bag, topic: str, rows: NDArray[np.int64]) -> tuple[SweepLook, ...]:
    """Return how the points of a few of the rows (N,) are timed, from beginning to end, without the unreadable."""
    picked = rows[np.linspace(0, len(rows) - 1, min(SWEEP_SAMPLES, len(rows))).astype(np.int64)]
    known = _kept(bag).looks
    for row in picked.tolist():
        if (topic, row) not in known:
            known[topic, row] = _look(bag, topic, row)
    return tuple(look for row in picked.tolist() if (look := known[topic, row]) is not None)


def _kept(bag: Bag) -> _Kept:
    return _KEPT.setdefault(bag, _Kept({}, {}))


def _look(bag: Bag, topic: str, row: int) -> SweepLook | None:
    try:
        cloud = cloud_at(bag, topic, row)
        points = points_in(bag, topic, cloud)
    except IngestError:
        return None
    timed = points.offset_ns if points.offset_ns is not None and len(points.offset_ns) else None
    span_ns = None if timed is None else (int(timed.min()), int(timed.max()))
    counts = (points.wrapped, points.filled, points.untimed)
    count = len(points.points_lidar) + points.untimed
    return SweepLook(row, count, points.time_meaning, span_ns, *counts, cloud.ignored, cloud.is_misdeclared)


@np.errstate(invalid="ignore", over="ignore")
def _end_values(column: NDArray[Any], kept: NDArray[np.int32]) -> tuple[int, int, int] | None:
    """Return first and last time near the core of a field's values, and the unit, all in ns; None for invalid times."""
    core, (least, last) = core_of(column, kept), span(column, kept)
    units = units_of(core, last - least)
    if not units:
        return None
    values = column[kept].astype(np.float64)
    near = values[np.abs(values - core.centre) <= reach_of(core, units[0])]
    return round(float(near.min()) * units[0]), round(float(near.max()) * units[0]), units[0]


def _ends(bag: Bag, topic: str) -> Iterator[_Ends]:
    """Yield the ends of a few sweeps with times, from beginning to end."""
    log_times_ns = bag.log_times_ns(topic)
    if not len(log_times_ns):
        return
    even = np.linspace(0, len(log_times_ns) - 1, SWEEP_SAMPLES).astype(np.int64)
    # Sweeps that are whole seconds apart would not show whether times restart each second.
    rows = np.unique(np.minimum(even + np.arange(SWEEP_SAMPLES) % 3, len(log_times_ns) - 1))
    for row in rows.tolist():
        try:
            cloud = cloud_at(bag, topic, row)
            kept = lidar_points(cloud, with_ring=False).rows
        except IngestError:
            continue
        for name in time_names(cloud.points) if len(kept) else ():
            column = cloud.points[name]
            ends = _end_values(column, kept)
            if ends is not None:
                first_ns, last_ns, unit_ns = ends
                word_ns = unit_ns << 32 if column.dtype.kind == "u" and column.dtype.itemsize == 4 else 0
                yield _Ends(cloud.stamp_ns, int(log_times_ns[row]) - cloud.stamp_ns, first_ns, last_ns, word_ns)
                break


def _clock_of(ends: Sequence[_Ends]) -> tuple[PointClock | None, str]:
    """Return the clock on which the sweeps agree, and the point to which stamps belong: the headers' own if
    possible.
    """
    are_relative = _are_relative(ends)
    trusted = [end for end in ends if _is_certain(end.stamp_ns)]
    if len(trusted) < LEAST_SWEEPS and not are_relative:
        trusted = list(ends)  # for a run so short that its clock had just started all the time
    if len(trusted) < LEAST_SWEEPS:
        return None, ""
    word_ns = trusted[0].word_ns
    periods_ns = () if are_relative else (NS_PER_S, HOUR_NS, word_ns) if word_ns else (NS_PER_S,)
    candidates = [_agreed(trusted, period_ns) for period_ns in (0, *periods_ns)]
    agreed = [(clock, stamped) for clock, stamped in candidates if clock is not None]
    return next((end for end in agreed if not end[1]), agreed[0] if agreed else (None, ""))


def _agreed(ends: Sequence[_Ends], period_ns: int) -> tuple[PointClock | None, str]:
    """Return the clock of a period, or of none, on which nearly all sweeps agree."""
    if period_ns and any(end.first_ns < 0 or end.last_ns > period_ns for end in ends):
        return None, ""
    length_ns = _length_ns(ends)
    starts_ns, first = [end.first_ns - end.stamp_ns for end in ends], ends[0].stamp_ns
    apart = np.array([apart_ns(start - starts_ns[0], period_ns) for start in starts_ns], np.int64)
    after_ns = np.array([end.stamp_ns - first for end in ends], np.int64)
    drift = _drift(after_ns, apart)
    level = apart - drift * after_ns
    if not _agree(level, length_ns):
        return None, ""
    clock = PointClock(starts_ns[0] + round(float(np.median(level))), period_ns, drift, first)
    return _of_stamps(ends, clock, length_ns)


def _are_relative(ends: Sequence[_Ends]) -> bool:
    """Return whether sweeps start at one time by their points, as do sweeps whose times are relative to the stamp."""
    return not ends or _agree(np.array([end.first_ns for end in ends], np.float64), _length_ns(ends))


def _length_ns(ends: Sequence[_Ends]) -> int:
    return int(np.median([end.last_ns - end.first_ns for end in ends]))


def _agree(begin_ns: NDArray[np.float64], length_ns: int) -> bool:
    """Return whether nearly all of the times (N,) are within a part of a sweep of their median."""
    return bool(np.mean(np.abs(begin_ns - np.median(begin_ns)) <= AGREEING_SWEEPS * length_ns) >= LEAST_AGREEING)


def _drift(after_ns: NDArray[np.int64], apart_ns: NDArray[np.int64]) -> float:
    """Return the median slope of the distances (N,) over time; 0 if no two clocks differ so, or the run is short."""
    if np.ptp(after_ns) < LEAST_DRIFTING_NS:
        return 0.0
    first, other = np.triu_indices(len(after_ns), 1)
    is_apart = after_ns[first] != after_ns[other]
    first, other = first[is_apart], other[is_apart]
    slope = float(np.median((apart_ns[other] - apart_ns[first]) / (after_ns[other] - after_ns[first])))
    return slope if abs(slope) <= MOST_DRIFT else 0.0


def _of_stamps(ends: Sequence[_Ends], clock: PointClock, length_ns: int) -> tuple[PointClock, str]:
    """Return the clock relative to first points, and the point to which the stamps belong."""
    if -length_ns - LAST_LATE_NS // 2 <= apart_ns(clock.ahead_ns, clock.period_ns) <= LAST_LATE_NS // 2:
        return PointClock(0, clock.period_ns), ""  # the headers' own
    late_ns = float(np.median([end.late_ns for end in ends]))
    if 0 <= late_ns < LATE_SWEEPS * length_ns:
        return replace(clock, ahead_ns=clock.ahead_ns + length_ns), "last"
    return clock, "first"
