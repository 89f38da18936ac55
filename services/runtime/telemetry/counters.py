"""In-process counters, and their arithmetic.

**Conventions.** Counts are JSON: `{meter: {"label|label": value}}`; the value of a histogram is a list, how many fell
into each of its buckets (not cumulative, the last one is open) and then their sum. All only grow.
"""

import os
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from threading import Lock

from services.runtime.telemetry.metric_names import METERS, MetricDefinition

Value = float | list[float]
Counts = dict[str, dict[str, Value]]

BETWEEN = "|"


class ProcessCounters:
    """The counts of one process; any thread may add."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._counts: Counts = {}

    def add(self, meter: MetricDefinition, labels: tuple[str, ...], amount: float = 1.0) -> None:
        with self._lock:
            of_meter = self._counts.setdefault(meter.name, {})
            key = BETWEEN.join(labels)
            of_meter[key] = added(of_meter.get(key, 0.0), amount)

    def observe(self, meter: MetricDefinition, labels: tuple[str, ...], value: float) -> None:
        """One more in the histogram."""
        one = [0.0] * (len(meter.bounds) + 2)
        one[bisect_left(meter.bounds, value)] = 1.0
        one[-1] = max(value, 0.0)
        with self._lock:
            of_meter = self._counts.setdefault(meter.name, {})
            key = BETWEEN.join(labels)
            of_meter[key] = added(of_meter.get(key, one), one) if key in of_meter else one

    def merge(self, more: Counts) -> None:
        """Add what others counted."""
        with self._lock:
            self._counts = summed((self._counts, more))

    def counts(self) -> Counts:
        """A copy of the counts now."""
        with self._lock:
            return {name: {key: _copied(value) for key, value in of.items()} for name, of in self._counts.items()}


def summed(parts: Iterable[Mapping[str, Mapping[str, Value]]]) -> Counts:
    """All of them together. What no meter of this version is named after stays, what does not fit it is left out."""
    total: Counts = {}
    for part in parts:
        for name, of_meter in part.items():
            into = total.setdefault(name, {})
            for key, value in of_meter.items():
                into[key] = added(into[key], value) if key in into else _copied(value)
    return total


def less(now: Counts, before: Counts) -> Counts:
    """The counts made between `before` and `now`."""
    negative = {name: {key: _negated(value) for key, value in of.items()} for name, of in before.items()}
    return summed((now, negative))


def added(one: Value, other: Value) -> Value:
    """The sum; of histograms of two versions, whose buckets differ, the first alone."""
    if isinstance(one, list):
        fits = isinstance(other, list) and len(other) == len(one)
        return [a + b for a, b in zip(one, other, strict=True)] if fits and isinstance(other, list) else one
    return one if isinstance(other, list) else one + other


def _copied(value: Value) -> Value:
    return list(value) if isinstance(value, list) else value


def _negated(value: Value) -> Value:
    return [-one for one in value] if isinstance(value, list) else -value


NAMED = {meter.name: meter for meter in METERS}
_OURS: dict[int, ProcessCounters] = {}


def process_counters() -> ProcessCounters:
    """The counters of this process; a forked child begins anew."""
    ours = _OURS.get(os.getpid())
    return _OURS.setdefault(os.getpid(), ProcessCounters()) if ours is None else ours
