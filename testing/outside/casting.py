"""Rays into an analytic world, each to its first hit.

**Conventions.** Directions are unit vectors; a range is metres along the ray, inf without a hit. `hit` is the index of
the solid, -1 for the ground, -2 for nothing. Intersections with solids have a closed form. For the ground, a ray
advances by `STEP_M` while it is below the highest ground of its square of `CELL_M`, then bisection refines the hit. A
crest thinner than a step may be missed.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from testing.outside.ground import Array, Ground, height_at, heights_m
from testing.outside.solids import BOX, ELLIPSOID, GRASS, Solids

NEAR_M, FAR_M = 0.5, 60.0
CELL_M, STEP_M = 1.0, 0.1
SLACK_M = 0.05  # the highest ground of a square is taken at points 0.1 m apart
GROUND, NOTHING = -1, -2


class Ceiling:
    """The highest ground of each square of `CELL_M`, of the plan from `low_m` to `high_m`."""

    def __init__(self, ground: Ground, low_m: Array, high_m: Array) -> None:
        self.low_m = np.floor(low_m)
        shape = np.ceil((high_m - self.low_m) / CELL_M).astype(int)
        per = 11
        offsets = np.stack(np.meshgrid(np.linspace(0, CELL_M, per), np.linspace(0, CELL_M, per)), axis=-1).reshape(
            -1, 2
        )
        corners = np.stack(np.meshgrid(*(np.arange(n) * CELL_M for n in shape), indexing="ij"), axis=-1) + self.low_m
        self.top_m = heights_m(ground, corners[:, :, None, :] + offsets).max(axis=-1) + SLACK_M


def cast(
    rays: tuple[Array, Array], ground: Ground, ceiling: Ceiling, solids: Solids, luck: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Return ranges (N,) and hits (N,) of rays (origins (N, 3), directions (N, 3)).

    `luck` (N,) in (0, 1) decides how far each ray penetrates bushes, crowns and grass.
    """
    sizes = np.concatenate(
        [solids["centre_m"], solids["half_m"], solids["yaw_rad"][:, None], solids["free_path_m"][:, None]], axis=1
    )
    return _cast(*rays, ground, ceiling.low_m, ceiling.top_m, solids["shape"].copy(), sizes, luck)  # type: ignore[no-any-return]


@njit(cache=True, nogil=True)
def _cast(origins, directions, ground, low, top, shapes, sizes, luck):  # type: ignore[no-untyped-def]
    ranges, hits = np.full(len(origins), np.inf), np.full(len(origins), NOTHING, np.int64)
    for i in range(len(origins)):
        o, d = origins[i], directions[i]
        best = _ground_range(o, d, ground, low, top)
        hit = GROUND if best < np.inf else NOTHING
        for k in range(len(shapes)):
            enter, leave = _interval(o, d, shapes[k], sizes[k])
            if leave <= NEAR_M or enter >= best or enter > leave:
                continue
            enter = max(enter, NEAR_M)
            through = -np.log(_drawn(luck[i], k)) * sizes[k, 7]
            if shapes[k] == GRASS:
                met = _grass_range(o, d, enter, min(leave, best), sizes[k], ground, through)
            else:
                met = enter + through if enter + through < leave else np.inf
            if met < best:
                best, hit = met, k
        if best <= FAR_M:
            ranges[i], hits[i] = best, hit
    return ranges, hits


@njit(cache=True, nogil=True)
def _drawn(luck, k):  # type: ignore[no-untyped-def]
    """Return another number in (0, 1) for each solid of one ray."""
    return (luck * (k * 7919 + 104729)) % 1.0 * 0.999999 + 5e-7


@njit(cache=True, nogil=True)
def _ground_range(o, d, ground, low, top):  # type: ignore[no-untyped-def]
    t = NEAR_M
    while t < FAR_M:
        x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
        i, j = int((x - low[0]) // CELL_M), int((y - low[1]) // CELL_M)
        if i < 0 or j < 0 or i >= top.shape[0] or j >= top.shape[1]:
            return np.inf
        until = min(t + _to_border(x - low[0] - i * CELL_M, d[0]), t + _to_border(y - low[1] - j * CELL_M, d[1])) + 1e-6
        if min(z, o[2] + until * d[2]) < top[i, j]:
            hit = _crossing(o, d, t, until, ground)
            if hit < np.inf:
                return hit
        t = until
    return np.inf


@njit(cache=True, nogil=True)
def _to_border(inside, rate):  # type: ignore[no-untyped-def]
    """Return the distance along the ray to the border of its square, along one axis."""
    if rate > 1e-9:
        return (CELL_M - inside) / rate
    return inside / -rate if rate < -1e-9 else FAR_M


@njit(cache=True, nogil=True)
def _above(o, d, t, ground):  # type: ignore[no-untyped-def]
    return o[2] + t * d[2] - height_at(o[0] + t * d[0], o[1] + t * d[1], ground)


@njit(cache=True, nogil=True)
def _crossing(o, d, begin, end, ground):  # type: ignore[no-untyped-def]
    t = begin
    while t < end:
        after = min(t + STEP_M, end)
        if _above(o, d, after, ground) <= 0:
            for _ in range(16):
                middle = 0.5 * (t + after)
                if _above(o, d, middle, ground) <= 0:
                    after = middle
                else:
                    t = middle
            return after
        t = after
    return np.inf


@njit(cache=True, nogil=True)
def _grass_range(o, d, enter, leave, size, ground, through):  # type: ignore[no-untyped-def]
    """Return the range at which a ray that penetrates `through` of grass meets a blade."""
    gone, t = 0.0, enter
    while t < leave:
        step = min(STEP_M, leave - t)
        x, y = o[0] + (t + 0.5 * step) * d[0], o[1] + (t + 0.5 * step) * d[1]
        blades = 2 * size[5] * (0.8 + 0.2 * np.sin(7 * x) * np.sin(9 * y))
        if _above(o, d, t + 0.5 * step, ground) < blades:
            if gone + step > through:
                return t + through - gone
            gone += step
        t += step
    return np.inf


@njit(cache=True, nogil=True)
def _interval(o, d, shape, size):  # type: ignore[no-untyped-def]
    """Return the ranges at which a ray enters and leaves a solid (enter > leave: never)."""
    c, s = np.cos(size[6]), np.sin(size[6])
    ax, ay, pz = o[0] - size[0], o[1] - size[1], o[2] - size[2]
    px, py = c * ax + s * ay, c * ay - s * ax
    dx, dy, dz = c * d[0] + s * d[1], c * d[1] - s * d[0], d[2]
    if shape == BOX:
        enter, leave = _slab(px, dx, size[3])
        for p, rate, half in ((py, dy, size[4]), (pz, dz, size[5])):
            first, last = _slab(p, rate, half)
            enter, leave = max(enter, first), min(leave, last)
        return enter, leave
    if shape == ELLIPSOID:
        return _roots(px / size[3], py / size[4], pz / size[5], dx / size[3], dy / size[4], dz / size[5])
    enter, leave = _roots(px / size[3], py / size[3], 0.0, dx / size[3], dy / size[3], 0.0)
    if shape == GRASS:
        return enter, leave
    first, last = _slab(pz, dz, size[5])
    return max(enter, first), min(leave, last)


@njit(cache=True, nogil=True)
def _roots(px, py, pz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Return where |p + t d| is 1."""
    a, b, c = dx * dx + dy * dy + dz * dz, px * dx + py * dy + pz * dz, px * px + py * py + pz * pz - 1
    under = b * b - a * c
    if under < 0 or a < 1e-12:
        return (-np.inf, np.inf) if a < 1e-12 and c < 0 else (np.inf, -np.inf)
    root = np.sqrt(under)
    return (-b - root) / a, (-b + root) / a


@njit(cache=True, nogil=True)
def _slab(p, rate, half):  # type: ignore[no-untyped-def]
    if abs(rate) < 1e-12:
        return (-np.inf, np.inf) if abs(p) < half else (np.inf, -np.inf)
    first, second = (-half - p) / rate, (half - p) / rate
    return min(first, second), max(first, second)
