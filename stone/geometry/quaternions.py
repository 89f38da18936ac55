"""Rotations inside compiled loops: unit quaternions `wxyz` and vectors as plain tuples.

**Conventions.** Formulas and their order equal `stone.geometry.se3`, which is the oracle; only sine and arctangent may
differ in the last bit, because numpy has its own.
"""

import math

from numba import njit

from stone.geometry.se3 import LINEAR_BELOW_RAD

Wxyz = tuple[float, float, float, float]
Xyz = tuple[float, float, float]


@njit(inline="always")
def product(a: Wxyz, b: Wxyz) -> Wxyz:
    """Return the Hamilton product: the rotation `b`, then `a`."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@njit(inline="always")
def conjugate(a: Wxyz) -> Wxyz:
    """Return the inverse rotation."""
    return a[0], -a[1], -a[2], -a[3]


@njit(inline="always")
def unit(a: Wxyz) -> Wxyz:
    """Return `a` normalised."""
    norm = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3])
    return a[0] / norm, a[1] / norm, a[2] / norm, a[3] / norm


@njit(inline="always")
def cross(a: Xyz, b: Xyz) -> Xyz:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(inline="always")
def turned(a: Wxyz, v: Xyz) -> Xyz:
    """Return the rotated vector."""
    axis, w = (a[1], a[2], a[3]), a[0]
    x, y, z = cross(axis, v)
    twice = 2.0 * x, 2.0 * y, 2.0 * z
    more = cross(axis, twice)
    return v[0] + w * twice[0] + more[0], v[1] + w * twice[1] + more[1], v[2] + w * twice[2] + more[2]


@njit(inline="always")
def slerped(a: Wxyz, b: Wxyz, ratio: float) -> Wxyz:
    """Return `a` at ratio 0, `b` at 1, along the shorter arc (see `stone.geometry.se3.slerp`)."""
    if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0:
        b = (-b[0], -b[1], -b[2], -b[3])
    apart = math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2 + (a[3] - b[3]) ** 2)
    joined = math.sqrt((a[0] + b[0]) ** 2 + (a[1] + b[1]) ** 2 + (a[2] + b[2]) ** 2 + (a[3] + b[3]) ** 2)
    angle = 2 * math.atan2(apart, joined)
    from_a, from_b = 1 - ratio, ratio
    if angle >= LINEAR_BELOW_RAD:
        from_a, from_b = math.sin(from_a * angle) / math.sin(angle), math.sin(from_b * angle) / math.sin(angle)
    blend = (
        from_a * a[0] + from_b * b[0],
        from_a * a[1] + from_b * b[1],
        from_a * a[2] + from_b * b[2],
        from_a * a[3] + from_b * b[3],
    )
    return unit(blend)
