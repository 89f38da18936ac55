"""Association of samples with the stamps of another clock.

**Conventions.** Stamps are int64 nanoseconds: float64 seconds of a current date have a resolution of 238 ns. `dt_ns` is
signed: sample − query. Index −1 (with dt 0) means that no sample is near enough. Samples must be sorted by time,
otherwise `numpy.searchsorted` would silently return wrong results.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused

Stamps = NDArray[np.int64]

# A camera triggered at the start of the sweep jitters around the sweep's stamp. With this guard its phase is near zero
# instead of near a whole period. Residuals up to 2 ms count as on time (design §3).
PHASE_GUARD_NS = 2_000_000


@dataclass(frozen=True, eq=False)
class Nearest:
    """For each query, the `index` (N,) of its sample (−1 for none), and `dt_ns` (N,) = sample − query (0 for none)."""

    index: NDArray[np.int64]
    dt_ns: NDArray[np.int64]


def require_sorted(name: str, stamps_ns: Stamps) -> None:
    """Raise `unsorted_stamps` at the first stamp that is earlier than the previous one."""
    back = np.flatnonzero(stamps_ns[1:] < stamps_ns[:-1])
    if back.size:
        at = int(back[0])
        raise Refused(
            "unsorted_stamps",
            f"{name}[{at + 1}] is {int(stamps_ns[at + 1]) - int(stamps_ns[at])} ns after the previous stamp; "
            "sort the stamps first",
        )


def nearest_samples(queries_ns: Stamps, stamps_ns: Stamps, tolerance_ns: int) -> Nearest:
    """Return the nearest sample within ±`tolerance_ns` (inclusive) of each query; ties go to the earlier sample.

    Queries may have any order; the first of samples with equal stamps is used. Without samples every index is −1.
    Raises `unsorted_stamps` if `stamps_ns` decrease.
    """
    require_sorted("stamps_ns", stamps_ns)
    if stamps_ns.size == 0:
        return Nearest(np.full(queries_ns.shape, -1, np.int64), np.zeros(queries_ns.shape, np.int64))
    after = np.searchsorted(stamps_ns, queries_ns, side="left")
    later = np.minimum(after, stamps_ns.size - 1)
    # Equal stamps before the query: use the first of them, as on the later side.
    earlier = np.searchsorted(stamps_ns, stamps_ns[np.maximum(after - 1, 0)], side="left")
    is_earlier = np.abs(queries_ns - stamps_ns[earlier]) <= np.abs(stamps_ns[later] - queries_ns)
    index = np.where(is_earlier, earlier, later).astype(np.int64)
    dt_ns = stamps_ns[index] - queries_ns
    is_near = np.abs(dt_ns) <= tolerance_ns
    return Nearest(np.where(is_near, index, -1), np.where(is_near, dt_ns, 0))


def typical_period_ns(stamps_ns: Stamps) -> int:
    """Return the median step between stamps in ns, or 0 for fewer than two stamps."""
    return int(np.median(np.diff(stamps_ns))) if stamps_ns.size > 1 else 0


def trigger_phase_ns(frames_ns: Stamps, stamps_ns: Stamps, period_ns: int) -> int:
    """Return the sensor's trigger delay after a frame's stamp: the median on the circle of one period.

    The result is in [−2 ms, period − 2 ms), or 0 if no sample falls into a frame's period. The median is taken around
    the circular mean, so phases on both sides of the wrap do not average to half a period. Raises `unsorted_stamps` if
    `frames_ns` decrease.
    """
    require_sorted("frames_ns", frames_ns)
    frame = np.searchsorted(frames_ns, stamps_ns, side="right") - 1
    since_ns = stamps_ns[frame >= 0] - frames_ns[frame[frame >= 0]]
    since_ns = since_ns[since_ns < period_ns]
    if since_ns.size == 0:
        return 0
    turn = np.exp(2j * np.pi * since_ns / period_ns)
    centre_ns = int(np.angle(turn.mean()) / (2 * np.pi) * period_ns)
    around_ns = (since_ns - centre_ns + period_ns // 2) % period_ns - period_ns // 2
    phase_ns = centre_ns + int(np.median(around_ns))
    return (phase_ns + PHASE_GUARD_NS) % period_ns - PHASE_GUARD_NS


def triggered_samples(frames_ns: Stamps, stamps_ns: Stamps, period_ns: int) -> tuple[Nearest, int]:
    """Return the sample that each frame triggered (nearest to stamp + phase within half a period), and the phase.

    The nearest sample to the stamp itself would be a neighbour's if the phase exceeds half a period. `dt_ns` is sample
    − frame stamp, so `dt_ns` − phase is the residual. Raises `unsorted_stamps` if either side decreases.
    """
    phase_ns = trigger_phase_ns(frames_ns, stamps_ns, period_ns)
    nearest = nearest_samples(frames_ns + phase_ns, stamps_ns, max(period_ns // 2 - 1, 0))
    return Nearest(nearest.index, np.where(nearest.index >= 0, nearest.dt_ns + phase_ns, 0)), phase_ns
