"""Association of samples with the stamps of another clock.

**Conventions.** Stamps are integer nanoseconds, int64 throughout: float64 seconds of today's date resolve 238 ns.
`dt_ns` is signed: sample − query. Index −1 (with dt 0) means that no sample is near enough. Samples must not go
back in time; `numpy.searchsorted` would silently answer wrong.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused

Stamps = NDArray[np.int64]

# A camera triggered where the sweep begins jitters around the sweep's stamp; its phase is then near zero rather than
# near a whole period (design §3: a residual of 2 ms is the limit of what counts as on time).
PHASE_GUARD_NS = 2_000_000


@dataclass(frozen=True, eq=False)
class Nearest:
    """For each query the `index` (N,) of its sample, −1 for none, and `dt_ns` (N,) = sample − query, 0 for none."""

    index: NDArray[np.int64]
    dt_ns: NDArray[np.int64]


def require_sorted(name: str, stamps_ns: Stamps) -> None:
    """Raises `unsorted_stamps` at the first stamp that is earlier than the one before it."""
    back = np.flatnonzero(stamps_ns[1:] < stamps_ns[:-1])
    if back.size:
        at = int(back[0])
        raise Refused(
            "unsorted_stamps",
            f"{name}[{at + 1}] is {int(stamps_ns[at + 1]) - int(stamps_ns[at])} ns after the previous stamp; "
            "sort the stamps first",
        )


def nearest_samples(queries_ns: Stamps, stamps_ns: Stamps, tolerance_ns: int) -> Nearest:
    """The sample nearest to each query within ±`tolerance_ns`, limits included; of two equally near, the earlier.

    Queries may come in any order; of samples with equal stamps the first is taken. No samples: every index is −1.
    Raises `unsorted_stamps` when `stamps_ns` go back.
    """
    require_sorted("stamps_ns", stamps_ns)
    if stamps_ns.size == 0:
        return Nearest(np.full(queries_ns.shape, -1, np.int64), np.zeros(queries_ns.shape, np.int64))
    after = np.searchsorted(stamps_ns, queries_ns, side="left")
    later = np.minimum(after, stamps_ns.size - 1)
    # The stamp before may be repeated: the first of its equals is the sample, as it is on the later side.
    earlier = np.searchsorted(stamps_ns, stamps_ns[np.maximum(after - 1, 0)], side="left")
    is_earlier = np.abs(queries_ns - stamps_ns[earlier]) <= np.abs(stamps_ns[later] - queries_ns)
    index = np.where(is_earlier, earlier, later).astype(np.int64)
    dt_ns = stamps_ns[index] - queries_ns
    is_near = np.abs(dt_ns) <= tolerance_ns
    return Nearest(np.where(is_near, index, -1), np.where(is_near, dt_ns, 0))


def typical_period_ns(stamps_ns: Stamps) -> int:
    """Median step between stamps, ns; 0 for fewer than two."""
    return int(np.median(np.diff(stamps_ns))) if stamps_ns.size > 1 else 0


def trigger_phase_ns(frames_ns: Stamps, stamps_ns: Stamps, period_ns: int) -> int:
    """How long after a frame's stamp this sensor fires: the median, on the circle of one period.

    In [−2 ms, period − 2 ms); 0 when no sample falls into a frame's period. Phases on both sides of the turn average to
    the turn, not to half a period, because the median is taken around the circular mean.
    Raises `unsorted_stamps` when `frames_ns` go back.
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
    """The sample each frame triggered, and the learnt phase: nearest to stamp + phase within half a period.

    The nearest sample to the stamp itself would be the neighbour's for a phase beyond half a period. `dt_ns` is
    sample − frame stamp, so `dt_ns` − phase is the residual. Raises `unsorted_stamps` when either side goes back.
    """
    phase_ns = trigger_phase_ns(frames_ns, stamps_ns, period_ns)
    found = nearest_samples(frames_ns + phase_ns, stamps_ns, max(period_ns // 2 - 1, 0))
    return Nearest(found.index, np.where(found.index >= 0, found.dt_ns + phase_ns, 0)), phase_ns
