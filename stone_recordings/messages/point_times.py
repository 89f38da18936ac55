"""Times of points around the stamp of their sweep, in any field, unit and clock of a driver.

**Conventions.** Names only nominate fields. The core of a sweep decides: the two fifths of its times that lie closest
together. The unit is the one in which a sweep lasts between 1 ms and 1 s. Times within `NEAR_NS` of 0 are relative to
the stamp, times that near to the stamp are absolute. Times that near modulo an hour count from the top of the hour
(Velodyne). Unsigned words that wrapped below the stamp are small negative times. A time far from the core is invalid:
the point gets the time between its neighbours in storage order if these agree, else it is dropped. Source: Hesai ROS
2.0, Nebula, Velodyne, Ouster and RoboSense drivers.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
TIME_NAMES = ("timestamp", "time_stamp", "time", "t", "offset_time", "timeStamp", "ts")
# Nanoseconds per unit; a sweep of 1 to 1000 Hz lasts 1e6 to 1e9 ns, so at most one unit fits a spread of values.
UNIT_NAMES = {NS_PER_S: "s", 1_000_000: "ms", 1_000: "µs", 1: "ns"}
UNITS_NS = tuple(UNIT_NAMES)
LEAST_SWEEP_NS, LAST_SWEEP_NS = 1e6, 1e9
# On one clock, the core of a sweep is no farther from its stamp; `stone.sensors.deskew` takes no time beyond a second.
NEAR_NS, LAST_OFFSET_NS = 750_000_000, NS_PER_S
HOUR_NS = 3600 * NS_PER_S
ANOTHER_CLOCK, OTHERS, NO_TIMES, TOO_COARSE = "another clock", "another clock's", "none", "too coarse"
# Positions in a sweep, evenly spread for any rows and columns (multiples of the golden ratio, modulo 1).
SAMPLE = np.modf(np.arange(512) * 0.6180339887498949)[0]
# Less than half, so that the core of a sweep in which a counter restarts lies on one side of the restart.
CORE_SHARE = 0.4
# Fewer points cannot reveal a few invalid times.
LEAST_POINTS = 16
# From its centre, times of a sweep reach at most this many lengths of its core; nearer times count as valid.
REACH_CORES, REACH_NS = 5.0, 250_000_000
# A longer span than this many cores probably contains invalid times.
MOST_CORES = 8.0
# Drivers write 0 for no time; a share above this is more than the first column's.
MOST_ZEROS = 0.01
# Neighbours agree within a tenth of a sweep, and so do nine of ten pairs of a cloud that is stored in order.
AGREEING_CORES, LEAST_ORDERED = 0.2, 0.9
COARSE_NS, DAY_NS = 10_000_000, 86_400 * NS_PER_S
UNTIMED = np.iinfo(np.int64).min


@dataclass(frozen=True)
class PointClock:
    """The clock of a topic's points: `ahead_ns` of the headers' at stamp `since_ns`, by `drift` more for each ns later.

    It restarts after each `period_ns`, if that is not 0.
    """

    ahead_ns: int = 0
    period_ns: int = 0
    drift: float = 0.0
    since_ns: int = 0


@dataclass(frozen=True, eq=False)
class PointTimes:
    """Offsets (N,) from the stamp in ns, `UNTIMED` for points without one; None if none could be read.

    `meaning` is how they were read. `wrapped` points had a time below the stamp in an unsigned word, `filled` points
    got the time between their neighbours, `untimed` points have none.
    """

    offset_ns: NDArray[np.int64] | None
    meaning: str
    wrapped: int = 0
    filled: int = 0
    untimed: int = 0


class Core(NamedTuple):
    """Centre and length of the core of a sweep's times, in the field's unit; whether many are 0."""

    centre: float
    length: float
    has_zeros: bool


class _Reading(NamedTuple):
    """`offset = (value − base) · unit − rest`; modulo `period` if the field has one, or of wrapped words."""

    meaning: str
    unit_ns: int
    base: float = 0.0
    rest_ns: int = 0
    period: float = 0.0
    is_wrapped: bool = False


def point_times(
    points: NDArray[np.void], kept: NDArray[np.int32], stamp_ns: int, clock: PointClock | None = None
) -> PointTimes:
    """Return the times of `points[kept]` by the first nominated field whose values are times."""
    times = PointTimes(None, NO_TIMES)
    for name in time_names(points):
        if len(kept):
            times = offsets_from_values(points[name], kept, stamp_ns, clock)
        if times.offset_ns is not None:
            break
    return times


def time_names(points: NDArray[np.void]) -> list[str]:
    """Return the names of the fields that may hold times."""
    names = points.dtype.names or ()
    return [name for name in TIME_NAMES if name in names and points.dtype[name].kind in "fiu"]


@np.errstate(invalid="ignore", over="ignore")  # NaN, infinite and huge numbers are not times
def offsets_from_values(
    column: NDArray[Any], kept: NDArray[np.int32], stamp_ns: int, clock: PointClock | None = None
) -> PointTimes:
    """Return the offsets of `column[kept]` from the stamp; `clock` is that of the points if it differs from the
    header's.
    """
    (least, last), core = span(column, kept), core_of(column, kept)
    units = units_of(core, last - least)
    readings = (_reading(column, core, unit_ns, stamp_ns, clock) for unit_ns in units)
    read = next((each for each in readings if each is not None), None)
    if read is None:
        return PointTimes(None, _unread(column, core, stamp_ns, ANOTHER_CLOCK if units else NO_TIMES))
    unit_ns = read.unit_ns
    offset_ns, reach = np.empty(len(kept), np.int64), reach_of(core, unit_ns)
    ends_ns = [(end - read.base) * unit_ns - read.rest_ns for end in (least, last)]
    is_plain = not core.has_zeros and not read.period and core.centre - reach <= least and last <= core.centre + reach
    if is_plain and max(map(abs, ends_ns)) <= LAST_OFFSET_NS:
        scaled(column, kept, read.base, float(unit_ns), offset_ns)
        offset_ns -= read.rest_ns
        return PointTimes(offset_ns, read.meaning)
    return _robust(column, kept, core, read) if len(kept) >= LEAST_POINTS else PointTimes(None, NO_TIMES)


def core_of(column: NDArray[Any], kept: NDArray[np.int32]) -> Core:
    """Return the core of `column[kept]` from a sample; its length is 0 if too few values are finite."""
    rows = kept if len(kept) <= len(SAMPLE) else kept[(SAMPLE * len(kept)).astype(np.int64)]
    values = column[rows].astype(np.float64)
    is_zero = values == 0
    has_zeros = float(is_zero.mean()) > MOST_ZEROS
    values = np.sort(values[np.isfinite(values) & ~(is_zero & has_zeros)])
    if len(values) < 2 or 2 * len(values) < len(rows) * (1 - MOST_ZEROS):
        return Core(float(values[0]) if len(values) else 0.0, 0.0, has_zeros)
    inner = max(1, int(CORE_SHARE * len(values)))
    widths = values[inner:] - values[: len(values) - inner]
    at = int(np.argmin(widths))
    return Core(float(values[at] + widths[at] / 2), float(widths[at]), has_zeros)


def units_of(core: Core, length: float) -> tuple[int, ...]:
    """Return the units in ns in which the core has a sweep's duration; `length` is that of all values."""
    lengths = (length,) if length <= MOST_CORES * core.length else (core.length / CORE_SHARE, length)
    units = (unit for duration in lengths for unit in UNITS_NS if LEAST_SWEEP_NS < duration * unit <= LAST_SWEEP_NS)
    return tuple(dict.fromkeys(units)) if core.length else ()


def reach_of(core: Core, unit_ns: int) -> float:
    """Return how far from the centre of the core a time of the sweep may be, in the field's unit."""
    return max(REACH_CORES * core.length, REACH_NS / unit_ns)


def _reading(
    column: NDArray[Any], core: Core, unit_ns: int, stamp_ns: int, clock: PointClock | None
) -> _Reading | None:
    """Return how to read the times: by the known clock, else by their nearest reference."""
    unit, centre_ns = UNIT_NAMES[unit_ns], round(core.centre * unit_ns)
    if clock is not None:
        whose = OTHERS if clock.ahead_ns else "absolute"
        return _by_clock(f"{whose} {unit}", centre_ns, unit_ns, (stamp_ns, clock))
    relative = _Reading(f"relative {unit}", unit_ns, is_wrapped=True)
    if abs(centre_ns) <= NEAR_NS:
        return relative
    read = _by_clock(f"absolute {unit}", centre_ns, unit_ns, (stamp_ns, PointClock()))
    if read is None and abs(unwrapped.py_func(core.centre)) * unit_ns <= NEAR_NS:
        return relative
    if read is None and column.dtype.kind in "iu" and 0 <= centre_ns <= HOUR_NS:
        read = _by_clock(f"{unit} of the hour", centre_ns, unit_ns, (stamp_ns, PointClock(0, HOUR_NS)))
    return read


def _by_clock(meaning: str, centre_ns: int, unit_ns: int, at: tuple[int, PointClock]) -> _Reading | None:
    """Return the reading by a clock if it puts the core near the stamp."""
    stamp_ns, clock = at
    there_ns = stamp_ns + clock.ahead_ns + round(clock.drift * (stamp_ns - clock.since_ns))
    if clock.period_ns:
        there_ns %= clock.period_ns
    if abs(apart_ns(centre_ns - there_ns, clock.period_ns)) > NEAR_NS:
        return None
    if clock.period_ns:  # the distance to the stamp is taken modulo the period, and is short
        return _Reading(meaning, unit_ns, there_ns / unit_ns, period=clock.period_ns / unit_ns)
    # Whole units of the stamp are subtracted first: the rest keeps every digit of the field.
    whole, rest_ns = divmod(there_ns, unit_ns)
    return _Reading(meaning, unit_ns, float(whole), rest_ns)


def apart_ns(distance_ns: int, period_ns: int) -> int:
    """Return the distance of two times of a clock that restarts after each period, if any."""
    return (distance_ns + period_ns // 2) % period_ns - period_ns // 2 if period_ns else distance_ns


def _unread(column: NDArray[Any], core: Core, stamp_ns: int, why: str) -> str:
    """Return why times cannot be read: dates in four bytes are steps of minutes."""
    if column.dtype.kind != "f" or column.dtype.itemsize > 4:
        return why
    grain = float(np.spacing(np.float32(abs(core.centre))))
    near = (unit for unit in UNITS_NS if abs(core.centre * unit - stamp_ns) < DAY_NS and grain * unit > COARSE_NS)
    return TOO_COARSE if next(near, None) else why


def _robust(column: NDArray[Any], kept: NDArray[np.int32], core: Core, read: _Reading) -> PointTimes:
    """Return the times of a sweep with wrapped or invalid times."""
    offset_ns, centre = (
        np.empty(len(kept), np.int64),
        unwrapped.py_func(core.centre) if read.is_wrapped else core.centre,
    )
    middle_ns = (_modulo(centre - read.base, read.period)) * read.unit_ns
    reach_ns = reach_of(core, read.unit_ns) * read.unit_ns
    limits = (
        max(middle_ns - reach_ns, read.rest_ns - float(LAST_OFFSET_NS)),
        min(middle_ns + reach_ns, read.rest_ns + float(LAST_OFFSET_NS)),
    )
    how = (read.base, float(read.unit_ns), read.period, read.is_wrapped)
    wrapped = placed(column, kept, how, limits, offset_ns)
    is_timed = offset_ns != UNTIMED
    offset_ns[is_timed] -= read.rest_ns
    tolerance_ns = round(AGREEING_CORES * core.length * read.unit_ns)
    zeros = 0
    if core.has_zeros and read.is_wrapped:
        zeros = _without_zeros(offset_ns, column[kept] == 0, tolerance_ns)
    filled = fill(offset_ns, tolerance_ns)
    untimed = int((offset_ns == UNTIMED).sum())
    if 2 * untimed > len(kept):
        return PointTimes(None, NO_TIMES)
    return PointTimes(offset_ns, read.meaning, wrapped, filled + zeros, untimed)


def _without_zeros(offset_ns: NDArray[np.int64], is_zero: NDArray[np.bool_], tolerance_ns: int) -> int:
    """Give zeros the time between their neighbours if these agree, but not on 0; return their number."""
    tried = offset_ns.copy()
    tried[is_zero] = UNTIMED
    fill(tried, tolerance_ns)
    is_wrong = is_zero & (tried != UNTIMED) & (np.abs(tried) > tolerance_ns)
    offset_ns[is_wrong] = tried[is_wrong]
    return int(is_wrong.sum())


def _modulo(distance: float, period: float) -> float:
    return distance - period * round(distance / period) if period else distance


# The hot loops: unaligned columns of a cloud's records in, offsets out. No fastmath: NaN must differ from numbers.

HALF_WORD, WORD, HALF_LONG, LONG = 2.0**31, 2.0**32, 2.0**63, 2.0**64


@njit(inline="always")
def unwrapped(value: float) -> float:
    """Return a time that an unsigned word of 32 or 64 bits holds, negative if it wrapped."""
    if HALF_WORD <= value < WORD:
        return value - WORD
    return value - LONG if HALF_LONG <= value <= LONG else value


@njit(cache=True, nogil=True)
def span(column: NDArray[Any], kept: NDArray[np.int32]) -> tuple[float, float]:
    """Return the least and greatest of `column[kept]`, NaN twice if one is not finite; `kept` is not empty."""
    least, last = np.inf, -np.inf
    for row in kept:
        value = np.float64(column[row])
        if not np.isfinite(value):
            return np.nan, np.nan
        least, last = min(least, value), max(last, value)
    return least, last


@njit(cache=True, nogil=True)
def scaled(
    column: NDArray[Any], kept: NDArray[np.int32], whole: float, unit_ns: float, offset_ns: NDArray[np.int64]
) -> None:
    """Set `offset_ns[i] = round((column[kept[i]] − whole) · unit_ns)`, half to even."""
    for index in range(len(kept)):
        offset_ns[index] = np.int64(np.rint((np.float64(column[kept[index]]) - whole) * unit_ns))


@njit(cache=True, nogil=True)
def placed(column, kept, how, limits, offset_ns):  # type: ignore[no-untyped-def]
    """Set `offset_ns` as `scaled` does, also from wrapped or periodic values, UNTIMED outside the limits.

    Returns the number of wrapped values.
    """
    base, unit_ns, period, is_wrapped = how
    wrapped = 0
    for index in range(len(kept)):
        value = np.float64(column[kept[index]])
        as_read = unwrapped(value) if is_wrapped else value
        distance = as_read - base
        if period > 0 and 0 <= value <= period:
            distance -= period * np.rint(distance / period)
        distance *= unit_ns
        if limits[0] <= distance <= limits[1]:
            offset_ns[index] = np.int64(np.rint(distance))
            wrapped += as_read != value
        else:
            offset_ns[index] = UNTIMED
    return wrapped


@njit(cache=True, nogil=True)
def fill(offset_ns, tolerance_ns):  # type: ignore[no-untyped-def]
    """Fill runs of UNTIMED between two times that agree, if nearly all neighbours do; return the number of filled
    ones.
    """
    pairs = agreeing = filled = 0
    for index in range(1, len(offset_ns)):
        if offset_ns[index] != UNTIMED and offset_ns[index - 1] != UNTIMED:
            pairs += 1
            agreeing += abs(offset_ns[index] - offset_ns[index - 1]) <= tolerance_ns
    if pairs == 0 or agreeing < LEAST_ORDERED * pairs:
        return filled
    last = -1
    for index in range(len(offset_ns)):
        if offset_ns[index] == UNTIMED:
            continue
        if 0 <= last < index - 1 and abs(offset_ns[index] - offset_ns[last]) <= tolerance_ns:
            step = (offset_ns[index] - offset_ns[last]) / (index - last)
            for between in range(last + 1, index):
                offset_ns[between] = offset_ns[last] + np.int64(step * (between - last))
                filled += 1
        last = index
    return filled
