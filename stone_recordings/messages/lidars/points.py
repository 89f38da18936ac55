"""What the packets of a scan measured, as the records of a cloud.

**Conventions.** Angles are degrees as the makers write them: azimuth clockwise seen from above, elevation upwards.
`zero_deg` is the bearing (counter-clockwise from x) of azimuth 0: Velodyne looks along x there, Hesai along y. Time is
the sensor's own spacing, laid on the clock of the packets' stamps by the median of what lies between the two: the
jitter of arrival is not in it, its mean delay is (under 1 ms on a wired network).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.lidar import LAST_CLOCK_DISTANCE_NS

POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time_stamp", "<i8")]
)


@dataclass(frozen=True, eq=False)
class PacketReturns:
    """Arrays that broadcast to one shape, that of `range_m`; a range of 0 is no return."""

    range_m: NDArray[np.float64]
    azimuth_deg: NDArray[np.float64]
    elevation_deg: NDArray[np.float64]
    intensity: NDArray[np.int64]
    ring: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    zero_deg: float


def records_of(returns: PacketReturns, stamp_ns: int) -> NDArray[np.void]:
    """The returns alone, in the order in which they were sent; times are relative to `stamp_ns`.

    Where the packets were stamped by another clock than the header, times stay absolute, by which readers know it.
    """
    is_return = returns.range_m > 0
    shape = is_return.shape
    points = np.empty(int(is_return.sum()), POINT)
    bearing = np.deg2rad(returns.zero_deg - np.broadcast_to(returns.azimuth_deg, shape)[is_return])
    elevation = np.deg2rad(np.broadcast_to(returns.elevation_deg, shape)[is_return])
    plan_m = returns.range_m[is_return] * np.cos(elevation)
    points["x"], points["y"] = plan_m * np.cos(bearing), plan_m * np.sin(bearing)
    points["z"] = returns.range_m[is_return] * np.sin(elevation)
    points["intensity"] = returns.intensity[is_return]
    points["ring"] = np.broadcast_to(returns.ring, shape)[is_return]
    time_ns = np.broadcast_to(returns.time_ns, shape)[is_return]
    is_near = len(time_ns) and abs(int(time_ns[0]) - stamp_ns) <= LAST_CLOCK_DISTANCE_NS
    points["time_stamp"] = time_ns - stamp_ns if is_near else time_ns
    return points


def packet_times_ns(counted_us: NDArray[np.int64], cycle_us: int, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """When packets (P,) were sent, P > 0; `counted_us` begins anew after every `cycle_us`."""
    steps_us = (np.diff(counted_us) + cycle_us // 2) % cycle_us - cycle_us // 2
    own_ns = 1000 * np.concatenate([[0], np.cumsum(steps_us)]).astype(np.int64)
    apart_ns = np.sort(stamps_ns - own_ns)
    return np.asarray(own_ns + apart_ns[len(apart_ns) // 2])


def without_repeats(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Distances (P, G, R, C) of R returns of one pulse, with 0 for each that a later one repeats."""
    kept = counts.copy()
    for earlier in range(counts.shape[2] - 1):
        for later in range(earlier + 1, counts.shape[2]):
            kept[:, :, earlier][counts[:, :, earlier] == counts[:, :, later]] = 0
    return kept
