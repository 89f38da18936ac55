"""In-process counters, and their arithmetic.

**Conventions.** Counts are JSON: `{meter: {"label|label": value}}`. The value of a histogram is a list: the count in
each bucket (not cumulative, the last bucket is open), then the sum. Counts only grow.
"""

import os
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from threading import Lock

# Definitions of all counters and histograms.
#
# **Conventions.** Names are the Prometheus names without `_total`. Labels have few values: kinds, outcomes, queues,
# directions; never an id or a name. A meter with `bounds` is a histogram with these bucket limits.


SECONDS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)
ANSWERS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
WAITS = (0.1, 0.5, 1.0, 5.0, 15.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, 86400.0)


@dataclass(frozen=True)
class MetricDefinition:
    """A counter, or with `bounds` a histogram."""

    name: str
    description: str
    labels: tuple[str, ...]
    bounds: tuple[float, ...] = ()


REQUESTS = MetricDefinition("stone_requests", "Requests answered", ("method", "route", "status"))
REQUEST_SECONDS = MetricDefinition("stone_request_seconds", "Duration of responses", ("method", "route"), ANSWERS)
REQUEST_BYTES = MetricDefinition("stone_request_bytes", "Bytes of bodies received and sent", ("direction",))
JOB_SECONDS = MetricDefinition("stone_job_seconds", "Duration of job attempts", ("kind", "outcome"), SECONDS)
JOB_WAIT_SECONDS = MetricDefinition(
    "stone_job_wait_seconds", "Time that jobs were ready before a worker claimed them", ("queue",), WAITS
)
JOB_CPU_SECONDS = MetricDefinition(
    "stone_job_cpu_seconds", "Processor time of attempts, including their children", ("kind",)
)
FRAMES = MetricDefinition("stone_frames", "Frames labelled, or scored against a ground truth", ("work",))
STORE_BYTES = MetricDefinition("stone_store_bytes", "Bytes written to and read from the store", ("direction",))
STORE_FAULTS = MetricDefinition(
    "stone_store_faults", "Objects that differ from their sha256 or are missing", ("found_by",)
)
LEASES_EXPIRED = MetricDefinition("stone_leases_expired", "Attempts ended because their lease expired", ("kind",))
WAKE_UPS_RESENT = MetricDefinition(
    "stone_wake_ups_resent", "Wake-ups sent again for ready jobs whose first wake-up was lost", ("queue",)
)
CHORE_FAILURES = MetricDefinition("stone_chore_failures", "Sweeper chores that an outage prevented", ("chore",))

METERS = (
    REQUESTS,
    REQUEST_SECONDS,
    REQUEST_BYTES,
    JOB_SECONDS,
    JOB_WAIT_SECONDS,
    JOB_CPU_SECONDS,
    FRAMES,
    STORE_BYTES,
    STORE_FAULTS,
    LEASES_EXPIRED,
    WAKE_UPS_RESENT,
    CHORE_FAILURES,
)

RENAMED = {"stone_queue_bells": "stone_queue_wake_ups", "stone_bells_rung_again": WAKE_UPS_RESENT.name}
"""New names of metrics by old ones, under which they are exposed too for one release."""


Value = float | list[float]
Counts = dict[str, dict[str, Value]]

BETWEEN = "|"


class ProcessCounters:
    """The counts of one process; any thread may add to them."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._counts: Counts = {}

    def add(self, meter: MetricDefinition, labels: tuple[str, ...], amount: float = 1.0) -> None:
        with self._lock:
            of_meter = self._counts.setdefault(meter.name, {})
            key = BETWEEN.join(labels)
            of_meter[key] = added(of_meter.get(key, 0.0), amount)

    def observe(self, meter: MetricDefinition, labels: tuple[str, ...], value: float) -> None:
        """Add a value to the histogram."""
        sample = [0.0] * (len(meter.bounds) + 2)
        sample[bisect_left(meter.bounds, value)] = 1.0
        sample[-1] = max(value, 0.0)
        with self._lock:
            of_meter = self._counts.setdefault(meter.name, {})
            key = BETWEEN.join(labels)
            of_meter[key] = added(of_meter.get(key, sample), sample) if key in of_meter else sample

    def merge(self, more: Counts) -> None:
        """Add the counts of another process."""
        with self._lock:
            self._counts = summed((self._counts, more))

    def counts(self) -> Counts:
        """Return a copy of the counts."""
        with self._lock:
            return {name: {key: _copied(value) for key, value in of.items()} for name, of in self._counts.items()}


def summed(parts: Iterable[Mapping[str, Mapping[str, Value]]]) -> Counts:
    """Return the sum of all counts. Unknown meters stay; values that do not fit their meter are dropped."""
    total: Counts = {}
    for part in parts:
        for name, of_meter in part.items():
            into = total.setdefault(name, {})
            for key, value in of_meter.items():
                into[key] = added(into[key], value) if key in into else _copied(value)
    return total


def less(now: Counts, before: Counts) -> Counts:
    """Return the counts made between `before` and `now`."""
    negative = {name: {key: _negate(value) for key, value in of.items()} for name, of in before.items()}
    return summed((now, negative))


def added(one: Value, other: Value) -> Value:
    """Return the sum; if the buckets of two versions differ, return the first histogram alone."""
    if isinstance(one, list):
        fits = isinstance(other, list) and len(other) == len(one)
        return [a + b for a, b in zip(one, other, strict=True)] if fits and isinstance(other, list) else one
    return one if isinstance(other, list) else one + other


def _copied(value: Value) -> Value:
    return list(value) if isinstance(value, list) else value


def _negate(value: Value) -> Value:
    return [-count for count in value] if isinstance(value, list) else -value


NAMED = {meter.name: meter for meter in METERS}
_OURS: dict[int, ProcessCounters] = {}


def process_counters() -> ProcessCounters:
    """Return the counters of this process; a forked child starts with new ones."""
    ours = _OURS.get(os.getpid())
    return _OURS.setdefault(os.getpid(), ProcessCounters()) if ours is None else ours
