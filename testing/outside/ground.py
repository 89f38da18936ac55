"""The ground of an analytic world: one height function z = f(x, y) of waves, mounds, ditches and banks.

**Conventions.** Metres in the world frame, z up. A ditch or bank lies along a segment: u is the position along it, v
the distance to the left of it. A mound's slope grows from its foot to its top in the steps of `MOUND_DEG`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOUND_RADII_M = np.array([1.0, 2.2, 3.6, 5.0, 6.5, 8.0])
MOUND_DEG = (42.0, 30.0, 22.5, 17.5, 12.5)  # from the top outwards, between these radii
_FALLS_M = np.diff(MOUND_RADII_M) * np.tan(np.deg2rad(MOUND_DEG))
MOUND_HEIGHTS_M = np.append(np.cumsum(_FALLS_M[::-1])[::-1], 0.0)
TAPER_M = 1.5  # length over which a ditch or a bank ends
BANK_FACE_M = 0.08
AROUND_M = 3.0  # beyond its length and a bank's ramp there is no ditch or bank


class Ground(NamedTuple):
    """The sum of parts, one row each.

    `waves` (W, 4): amplitude m, wave vector x and y rad/m, phase. `mounds` (M, 2): x, y. `ditches` (D, 7): x, y, yaw,
    half length, depth, half width of the floor, slope of the flanks (tangent). `banks` (B, 6): x, y, yaw, half length,
    height of the face, length of the ramp behind it, down to the ground again.
    """

    waves: Array
    mounds: Array
    ditches: Array
    banks: Array


@njit(cache=True, nogil=True)
def height_at(x, y, ground):  # type: ignore[no-untyped-def]
    """Return the ground's height at a point."""
    z, waves, mounds, ditches, banks = 0.0, ground.waves, ground.mounds, ground.ditches, ground.banks
    for k in range(len(waves)):
        z += waves[k, 0] * np.sin(waves[k, 1] * x + waves[k, 2] * y + waves[k, 3])
    for k in range(len(mounds)):
        away2 = (x - mounds[k, 0]) ** 2 + (y - mounds[k, 1]) ** 2
        if away2 < MOUND_RADII_M[-1] ** 2:
            z += np.interp(np.sqrt(away2), MOUND_RADII_M, MOUND_HEIGHTS_M)
    for k in range(len(ditches)):
        if (x - ditches[k, 0]) ** 2 + (y - ditches[k, 1]) ** 2 < (ditches[k, 3] + AROUND_M) ** 2:
            u, v = along(x, y, ditches[k])
            deep = min(ditches[k, 4], (ditches[k, 5] + ditches[k, 4] / ditches[k, 6] - abs(v)) * ditches[k, 6])
            z -= max(deep, 0.0) * tapered(u, ditches[k, 3])
    for k in range(len(banks)):
        if (x - banks[k, 0]) ** 2 + (y - banks[k, 1]) ** 2 < (banks[k, 3] + banks[k, 5] + AROUND_M) ** 2:
            u, v = along(x, y, banks[k])
            face = min(max(v / BANK_FACE_M + 0.5, 0.0), 1.0)
            z += banks[k, 4] * face * min(max(1.0 - (v - 1.0) / banks[k, 5], 0.0), 1.0) * tapered(u, banks[k, 3])
    return z


@njit(cache=True, nogil=True)
def along(x, y, row):  # type: ignore[no-untyped-def]
    """Return (u, v) of a point in the frame of a ditch or bank."""
    c, s = np.cos(row[2]), np.sin(row[2])
    return c * (x - row[0]) + s * (y - row[1]), c * (y - row[1]) - s * (x - row[0])


@njit(cache=True, nogil=True)
def tapered(u, half_length):  # type: ignore[no-untyped-def]
    """Return 1 along the segment, falling to 0 over `TAPER_M` at its ends."""
    return min(max((half_length - abs(u)) / TAPER_M, 0.0), 1.0)


@njit(cache=True, nogil=True)
def _heights(xy, ground):  # type: ignore[no-untyped-def]
    heights = np.empty(len(xy))
    for i in range(len(xy)):
        heights[i] = height_at(xy[i, 0], xy[i, 1], ground)
    return heights


def heights_m(ground: Ground, xy: Array) -> Array:
    """Return the height at points (..., 2)."""
    flat = np.ascontiguousarray(xy, np.float64).reshape(-1, 2)
    return np.asarray(_heights(flat, ground)).reshape(np.shape(xy)[:-1])
