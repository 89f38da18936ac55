"""The measurements in the packets of a scan, as the records of a cloud.

**Conventions.** Angles are degrees in the makers' convention: azimuth clockwise seen from above, elevation upwards.
`zero_deg` is the bearing (counter-clockwise from x) of azimuth 0: along x for Velodyne, along y for Hesai. Times have
the sensor's own spacing, shifted to the clock of the packets' stamps by the median of the differences. They contain the
mean delay of arrival (under 1 ms on a wired network), but not its jitter.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.point_times import NEAR_NS

POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time_stamp", "<i8")]
)


@dataclass(frozen=True, eq=False)
class PacketReturns:
    """Arrays that broadcast to the shape of `range_m`; a range of 0 is no return."""

    range_m: NDArray[np.float64]
    azimuth_deg: NDArray[np.float64]
    elevation_deg: NDArray[np.float64]
    intensity: NDArray[np.int64]
    ring: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    zero_deg: float


def records_of(returns: PacketReturns, stamp_ns: int) -> NDArray[np.void]:
    """Return the returns, in the order in which they were sent; times are relative to `stamp_ns`.

    If the packets were stamped by another clock than the header, times stay absolute, which readers detect.
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
    is_near = len(time_ns) and abs(int(time_ns[0]) - stamp_ns) <= NEAR_NS // 2
    points["time_stamp"] = time_ns - stamp_ns if is_near else time_ns
    return points


def packet_times_ns(counted_us: NDArray[np.int64], cycle_us: int, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return when packets (P,) were sent, P > 0; `counted_us` restarts after every `cycle_us`."""
    steps_us = (np.diff(counted_us) + cycle_us // 2) % cycle_us - cycle_us // 2
    own_ns = 1000 * np.concatenate([[0], np.cumsum(steps_us)]).astype(np.int64)
    apart_ns = np.sort(stamps_ns - own_ns)
    return np.asarray(own_ns + apart_ns[len(apart_ns) // 2])


def without_repeats(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the ranges (P, G, R, C) of R returns of one pulse, with 0 for each that a later one repeats."""
    kept = counts.copy()
    for earlier in range(counts.shape[2] - 1):
        for later in range(earlier + 1, counts.shape[2]):
            kept[:, :, earlier][counts[:, :, earlier] == counts[:, :, later]] = 0
    return kept


# The makers' default angles and firing times of each laser, in the order of the packets. Degrees: elevations upwards,
# azimuth offsets clockwise seen from above and added to a packet's azimuth. A unit's own angles differ from these by up
# to some tenths of a degree; they are in the sensor, not in its packets. Heights of the lasers in the housing (VLP-16:
# up to 11 mm) are left out, as in Nebula. Times are nanoseconds. Source: user manuals of the sensors;
# velodyne_pointcloud (params/), Nebula (calibration/, pandar_40, pandar_128e4x), which list these values. Velodyne's
# files hold the offsets with the other sign.


_VLP16_ELEVATION = (
    -15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15,
)  # fmt: skip
_VLP32C_ELEVATION = (
    -25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667,
    -4, -4.667, 1.667, 1, -3.667, -3.333, 3.333, 2.333, -2.667, -3, 7, 4.667, -2.333, -2, 15, 10.333, -1.333,
)  # fmt: skip
_VLP32C_AZIMUTH = (
    -1.4, 4.2, -1.4, 1.4, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4,
    4.2, -4.2, 1.4, -1.4, 1.4, -1.4, 1.4, -1.4, 4.2, -4.2, 1.4, -1.4, 1.4,
)  # fmt: skip
_VLS128_ELEVATION = (
    -11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31, -6.5, -1.11, 4.28, -4.41, 0.1, 6.48, -3.2, 2.19,
    -3.86, 1.53, -9.244, -1.77, 2.74, -5.95, -0.56, 4.83, -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58,
    -0.34, 5.18, -3.64, 1.75, -25, -2.43, 2.96, -5.73, 0.54, 9.7, -2.76, 2.63, -7.65, -1.55, 3.84, -4.85, 3.18,
    -5.51, -0.12, 5.73, -4.3, 1.09, -16.042, -2.21, 4.06, -4.63, 0.76, 15, -3.42, 1.97, -6.85, -1.33, -5.62,
    -0.23, 5.43, -3.53, 0.98, -19.582, -2.32, 3.07, -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44, 3.95, -2.1,
    3.29, -5.4, -0.01, 4.5, -4.19, 1.2, -13.565, -1.22, 4.17, -4.52, 0.87, 6.08, -3.31, 2.08, -6.65, 1.42,
    -10.346, -1.88, 3.51, -6.06, -0.67, 4.72, -3.97, 2.3, -6.39, -1, 4.39, -5.18, 0.21, 6.98, -3.09, 4.98,
    -3.75, 1.64, -8.352, -2.54, 2.85, -5.84, -0.45, 8.43, -2.87, 2.52, -6.17, -1.66, 3.73, -4.96, 0.43,
)  # fmt: skip
_VLS128_AZIMUTH_OF_EIGHT = (
    6.354, 4.548, 2.732, 0.911, -0.911, -2.732, -4.548, -6.354,
)  # fmt: skip
_PANDAR40P_ELEVATION = (
    14.794, 10.944, 7.971, 4.969, 2.952, 1.94, 1.6, 1.263, 0.925, 0.587, 0.249, -0.088, -0.425, -0.763, -1.101,
    -1.439, -1.776, -2.116, -2.453, -2.788, -3.128, -3.463, -3.8, -4.138, -4.473, -4.808, -5.145, -5.479,
    -5.814, -6.149, -7.151, -8.147, -9.148, -10.133, -11.12, -12.094, -13.062, -14.018, -18.977, -24.985,
)  # fmt: skip
_PANDAR40P_AZIMUTH = (
    -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208,
    -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125,
    -5.208, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042,
)  # fmt: skip
_OT128_ELEVATION = (
    15.139, 13.432, 11.919, 10.634, 9.967, 9.3, 8.621, 7.945, 7.595, 7.244, 6.905, 6.55, 6.193, 5.843, 5.482,
    5.116, 4.768, 4.402, 4.04, 3.68, 3.314, 2.94, 2.58, 2.203, 2.081, 1.967, 1.844, 1.71, 1.596, 1.474, 1.333,
    1.23, 1.109, 0.97, 0.856, 0.734, 0.597, 0.477, 0.361, 0.217, 0.102, -0.012, -0.146, -0.272, -0.387, -0.522,
    -0.649, -0.757, -0.899, -1.018, -1.135, -1.272, -1.397, -1.512, -1.648, -1.777, -1.884, -2.028, -2.146,
    -2.261, -2.397, -2.526, -2.639, -2.775, -2.894, -3.016, -3.154, -3.271, -3.394, -3.534, -3.644, -3.768,
    -3.913, -4.022, -4.149, -4.285, -4.405, -4.52, -4.662, -4.777, -4.896, -5.043, -5.155, -5.272, -5.419,
    -5.539, -5.654, -5.806, -5.907, -6.288, -6.669, -7.039, -7.416, -7.794, -8.173, -8.546, -8.915, -9.295,
    -9.666, -10.041, -10.414, -10.785, -11.15, -11.521, -11.895, -12.26, -12.638, -12.992, -13.368, -13.727,
    -14.096, -14.451, -14.806, -15.167, -15.517, -15.881, -16.233, -16.585, -16.934, -17.288, -17.642, -18.332,
    -19.005, -19.665, -20.318, -21.598, -22.989, -24.71,
)  # fmt: skip
_OT128_AZIMUTH = (
    0.157, 0.129, 1.258, 1.247, 0.145, 0.123, 0.1, 0.078, 1.338, 1.316, 1.298, 1.28, 1.282, 1.334, 1.314, 1.363,
    0.141, 0.099, 0.171, 0.15, 0.115, 0.097, 0.166, 0.123, -3.092, 1.374, 4.55, -3.071, 1.362, 4.542, -3.033,
    1.385, 4.535, -3.053, 1.33, 4.609, -3.085, 1.314, 4.528, -3.064, 0.15, 2.981, -1.431, 0.173, 2.954, -1.445,
    0.139, 2.941, -1.478, 0.161, 3.027, -1.455, 0.131, 3.015, -1.495, 0.115, 2.985, -1.47, 0.202, 3.012, -1.505,
    0.188, 2.975, -1.521, 1.399, 4.636, -3.055, 1.374, 4.623, -3.068, 1.382, 4.595, -3.078, 1.336, 4.621,
    -3.093, 1.351, 4.587, -3.104, 1.358, 4.613, -3.119, 1.407, 4.677, -3.126, 1.421, 4.665, -3.147, 0.198,
    0.194, 0.171, 0.178, 0.148, 0.149, 0.123, 0.126, 1.427, 1.408, 1.433, 1.386, 1.411, 1.385, 1.363, 1.362,
    0.2, 0.179, 0.154, 0.133, 0.217, 0.194, 0.169, 0.147, 1.568, 1.59, 1.516, 1.536, 1.584, 1.557, 1.509, 1.533,
    0.361, 0.336, 0.313, 0.285, 1.59, 1.551, 0.312, 0.302,
)  # fmt: skip
# Before the packet's time, and after the block's.
_PANDAR40P_FIRING = (
    -42220, -28470, -16040, -3620, -45490, -31740, -47460, -54670, -20620, -33710, -40910, -8190, -20620,
    -27160, -50730, -8190, -14740, -36980, -45490, -52700, -23890, -31740, -38950, -11470, -18650, -25190,
    -48760, -6230, -12770, -35010, -21920, -9500, -43520, -29770, -17350, -4920, -42220, -28470, -16040, -3620,
)  # fmt: skip
_OT128_FIRING = (
    49758, 43224, 36690, 30156, 21980, 15446, 8912, 2378, 49758, 43224, 36690, 30156, 2378, 15446, 8912, 21980,
    43224, 30156, 49758, 15446, 36690, 2378, 21980, 8912, 34312, 45002, 38468, 40846, 40846, 34312, 51536,
    47380, 31934, 47380, 31934, 51536, 38468, 27778, 27778, 45002, 38468, 40846, 51536, 45002, 31934, 47380,
    34312, 27778, 38468, 40846, 51536, 45002, 31934, 34312, 27778, 38468, 40846, 51536, 45002, 31934, 47380,
    34312, 27778, 45002, 45002, 51536, 38468, 40846, 47380, 40846, 31934, 45002, 27778, 38468, 40846, 31934,
    27778, 38468, 34312, 34312, 34312, 47380, 51536, 31934, 51536, 47380, 27778, 49758, 21980, 43224, 15446,
    43224, 36690, 8912, 30156, 2378, 49758, 21980, 36690, 15446, 8912, 30156, 2378, 49758, 43224, 36690, 30156,
    21980, 15446, 8912, 2378, 43224, 49758, 30156, 36690, 21980, 15446, 2378, 8912, 49758, 43224, 36690, 30156,
    21980, 15446, 8912, 2378, 30156,
)  # fmt: skip

ELEVATION_DEG = {
    "VLP-16": np.array(_VLP16_ELEVATION, np.float64),
    "VLP-32C": np.array(_VLP32C_ELEVATION, np.float64),
    "VLS-128": np.array(_VLS128_ELEVATION, np.float64),
    "Pandar40P": np.array(_PANDAR40P_ELEVATION, np.float64),
    "OT128": np.array(_OT128_ELEVATION, np.float64),
}
AZIMUTH_DEG = {
    "VLP-16": np.zeros(16),
    "VLP-32C": np.array(_VLP32C_AZIMUTH, np.float64),
    "VLS-128": np.tile(np.array(_VLS128_AZIMUTH_OF_EIGHT, np.float64), 16),
    "Pandar40P": np.array(_PANDAR40P_AZIMUTH, np.float64),
    "OT128": np.array(_OT128_AZIMUTH, np.float64),
}
PANDAR40P_FIRING_NS = np.array(_PANDAR40P_FIRING, np.int64)
OT128_FIRING_NS = np.array(_OT128_FIRING, np.int64)
