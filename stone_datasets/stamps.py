"""Stamps of frames: microseconds of a set clock, of a clock that was never set, or stamps in another unit.

**Conventions.** A set clock gives 1990 to 2100. Simulated time and time since boot are outside. Their unit follows from
the steps between frames (10 ms to 10 s): below 10 it is seconds, below 10,000 milliseconds and so on. A scene with one
frame has no step; if its log's date is the stamp's date in another unit, that unit is used.
"""

from collections.abc import Iterator
from datetime import datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stone_base.newer_python import UTC

FIRST_US, LAST_US = 631_152_000_000_000, 4_102_444_800_000_000
LARGEST_US = (2**63 - 1) // 1000  # in nanoseconds they still fit int64
LEAST_STEP_US, MOST_STEP_US = 10_000, 10_000_000

Stamps = NDArray[np.int64]


class StampUnit(NamedTuple):
    """A possible unit of stamps, its microseconds, and the conversion to microseconds."""

    name: str
    microseconds: float
    mended: str


SECONDS = StampUnit("seconds", 1e6, "multiply by 1,000,000")
MILLISECONDS = StampUnit("milliseconds", 1e3, "multiply by 1,000")
MICROSECONDS = StampUnit("microseconds", 1, "write int(round(timestamp))")
NANOSECONDS = StampUnit("nanoseconds", 1e-3, "divide by 1,000")
UNITS = (SECONDS, MILLISECONDS, MICROSECONDS, NANOSECONDS)


class StampFault(NamedTuple):
    """The index of a stamp, its fault, and the mistake that usually causes it."""

    at: int
    what: str
    likely: str


def is_dated(stamps_us: Stamps) -> NDArray[np.bool_]:
    """Return whether the clock of each stamp was set."""
    return (stamps_us >= FIRST_US) & (stamps_us < LAST_US)


def are_dated(stamps_us: Stamps) -> bool:
    """Return whether the clock of most of these stamps (at least one) was set."""
    return FIRST_US <= float(np.median(stamps_us)) < LAST_US


def unit_of(stamp: float) -> StampUnit | None:
    """Return the unit in which a number is a date from 1990 to 2100, or None."""
    return next((unit for unit in UNITS if FIRST_US <= stamp * unit.microseconds < LAST_US), None)


def clock_faults(stamps: Stamps, date: str = "") -> Iterator[StampFault]:
    """Yield the stamps of one scene's frames (N,), in any order, that are not microseconds of the other frames' clock.

    `date` is the log's capture date in ISO 8601, or "" if unknown.
    """
    if not len(stamps):
        return
    scene_is_dated = are_dated(stamps)
    unit = MICROSECONDS if scene_is_dated else _unit_of_undated(np.sort(stamps), date)
    if unit is not MICROSECONDS:
        for at in range(len(stamps)):
            yield _of_unit(at, int(stamps[at]), unit)
        return
    yield from strangers(stamps, has_dated=scene_is_dated, has_undated=not scene_is_dated)


def strangers(stamps: Stamps, *, has_dated: bool, has_undated: bool) -> Iterator[StampFault]:
    """Yield the stamps (N,) of a clock that no frame uses."""
    dated = is_dated(stamps)
    for at in np.flatnonzero(dated & (not has_dated) | ~dated & (not has_undated)).tolist():
        stamp = int(stamps[at])
        unit = unit_of(stamp)
        if unit is not None and unit is not MICROSECONDS:
            yield _of_unit(at, stamp, unit)
        else:
            of = "1990 to 2100" if has_dated else "a clock that was not set"
            yield StampFault(at, f"timestamp is {stamp}, but frames have stamps from {of}", "another clock?")


def wrong_unit(unit: StampUnit) -> str:
    """Return the name of a stamp in this unit, and its conversion to microseconds."""
    return f"{unit.name} instead of integer microseconds: {unit.mended}"


def _of_unit(at: int, stamp: int, unit: StampUnit) -> StampFault:
    return StampFault(at, f"timestamp is {stamp}", wrong_unit(unit))


def _unit_of_undated(ascending: Stamps, date: str) -> StampUnit:
    """Return the unit of stamps that are not a date in microseconds."""
    if len(ascending) == 1:
        unit = unit_of(float(ascending[0]))
        return unit if unit is not None and date and date == _date(ascending[0] * unit.microseconds) else MICROSECONDS
    step = float(np.median(np.diff(ascending)))
    within = (unit for unit in UNITS if LEAST_STEP_US <= step * unit.microseconds < MOST_STEP_US)
    return next(within, SECONDS if step * SECONDS.microseconds < LEAST_STEP_US else NANOSECONDS)


def _date(stamp_us: float) -> str:
    return f"{datetime.fromtimestamp(int(stamp_us) // 10**6, UTC):%Y-%m-%d}"
