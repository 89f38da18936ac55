"""Requests, latencies and processor time of a load by quarter of its duration, to detect growth.

**Conventions.** Clients and the watch use the machine's monotonic clock. A request belongs to the quarter of its
answer; a program's processor time is divided among all requests of the quarter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.memory_watch import MemoryWatch

QUARTERS = 4
UNTIL_SCORED = "submit: until scored"  # a duration, not a request
Noted = Mapping[str, Sequence[float]]


@dataclass(frozen=True)
class LoadQuarter:
    """Requests per second, their latency in milliseconds, and CPU milliseconds per request of each program."""

    requests_per_s: float
    p50_ms: float
    p99_ms: float
    cpu_ms: Mapping[str, float]


def quarters(begun_s: Noted, waited_s: Noted, watch: MemoryWatch) -> list[LoadQuarter]:
    """Return the quarters of all answered requests; empty without answers."""
    kinds = [what for what in begun_s if what != UNTIL_SCORED]
    begun = np.array([at_s for what in kinds for at_s in begun_s[what]])
    waited = np.array([seconds for what in kinds for seconds in waited_s[what]])
    if not len(begun):
        return []
    ended, edges = begun + waited, np.linspace(begun.min(), (begun + waited).max(), QUARTERS + 1)
    quarter = np.clip(np.searchsorted(edges, ended, "right") - 1, 0, QUARTERS - 1)
    used = {name: np.diff(np.interp(edges, watch.looked_s[: len(s)], s)) for name, s in watch.used_s.items()}
    return [
        _quarter(waited[quarter == q], edges[q + 1] - edges[q], {n: s[q] for n, s in used.items()})
        for q in range(QUARTERS)
    ]


def _quarter(waited_s: np.ndarray, lasted_s: float, used_s: Mapping[str, float]) -> LoadQuarter:
    count = max(1, len(waited_s))
    p50, p99 = np.percentile(waited_s, [50, 99]) * 1e3 if len(waited_s) else (0.0, 0.0)
    cpu_ms = {name: float(seconds) * 1e3 / count for name, seconds in used_s.items()}
    return LoadQuarter(len(waited_s) / lasted_s, float(p50), float(p99), cpu_ms)
