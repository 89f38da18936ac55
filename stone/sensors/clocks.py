"""Comparison of clocks: offset, drift and jitter of stamps relative to their record times.

**Conventions.** The distance of a message is record time − stamp. Its median is the offset: transport delay plus clock
difference. Drift is how much faster the stamping clock runs than the recording clock, in parts per million (positive:
fast, so the distance shrinks). Jitter, here and in all pages and tables, is robust σ: 1.4826 times the median absolute
deviation, here from the line; for Gaussian noise it is σ. The line is Theil–Sen (median of the slopes between all
pairs), over block medians if there are many samples: up to 29 % of the blocks may be outliers. Sources: Theil 1950, Sen
1968, Huber 1981.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]
Array = NDArray[np.float64]

MAD_TO_SIGMA = 1.4826
MEDIAN_TO_SIGMA = 1.2533  # a median scatters √(π/2) times as much as a mean
BLOCKS = 64
LEAST_SAMPLES = 8
PPM = 1e6


@dataclass(frozen=True)
class ClockLine:
    """`drift_ppm` and its standard error are None below `LEAST_SAMPLES` samples, or if all record times are equal."""

    offset_ns: int
    jitter_ns: int
    drift_ppm: float | None
    drift_sigma_ppm: float | None


def clock_line(stamps_ns: Stamps, record_times_ns: Stamps) -> ClockLine | None:
    """Return the line of N ≥ 1 messages with ascending record times; None for N = 0."""
    if not stamps_ns.size:
        return None
    distance_ns = record_times_ns - stamps_ns
    first_ns = int(distance_ns[0])
    y = (distance_ns - first_ns).astype(np.float64)
    x = (record_times_ns - record_times_ns[0]).astype(np.float64)
    offset_ns = first_ns + round(float(np.median(y)))
    slope = robust_slope(x, y) if len(x) >= LEAST_SAMPLES and x[-1] > 0 else None
    if slope is None:
        return ClockLine(offset_ns, round(spread(y)), None, None)
    jitter_ns = spread(y - slope * x)
    sigma = MEDIAN_TO_SIGMA * jitter_ns / float(np.sqrt(len(x)) * np.std(x))
    return ClockLine(offset_ns, round(jitter_ns), -slope * PPM + 0.0, sigma * PPM)


def robust_slope(x: Array, y: Array) -> float:
    """Return the Theil–Sen slope of samples in ascending `x` (N,), over at most `BLOCKS` medians; 0 if all `x` are
    equal.
    """
    if len(x) > BLOCKS:
        edges = np.linspace(0, len(x), BLOCKS + 1).astype(np.int64)
        cuts = [slice(start, stop) for start, stop in pairwise(edges)]
        x, y = (np.array([np.median(values[cut]) for cut in cuts]) for values in (x, y))
    before, after = np.triu_indices(len(x), 1)
    run = x[after] - x[before]
    rise = (y[after] - y[before])[run > 0]
    return float(np.median(rise / run[run > 0])) if rise.size else 0.0


def spread(values: Array) -> float:
    """Return robust σ: 1.4826 × median absolute deviation from the median; 0 for no values."""
    if not values.size:
        return 0.0
    return MAD_TO_SIGMA * float(np.median(np.abs(values - np.median(values))))


def interval_jitter_ns(stamps_ns: Stamps) -> int:
    """Return σ of single stamps from their intervals, robust to lost messages and drift; 0 below three stamps.

    An interval has the noise of two stamps, so it scatters √2 times as much as one stamp.
    """
    return round(spread(np.diff(stamps_ns).astype(np.float64)) / np.sqrt(2)) if stamps_ns.size > 2 else 0
