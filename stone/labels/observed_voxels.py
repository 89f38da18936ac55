"""Observed voxels: every voxel that a LiDAR ray reached or passed.

**Conventions.** The set is stored as bricks of 4 × 4 × 4 voxels, one bit each in a uint64 word. Marking a voxel is
idempotent and sets from different sweeps are combined by OR, so order and grouping do not matter. The bit of a voxel is
(x·4 + y)·4 + z. Each brick also stores the first frame whose rays touched it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from stone.geometry.lattice import EMPTY, Keys, check_reach, pack, scatter, slot_of
from stone.geometry.se3 import SE3
from stone.kernels.lanes import I32, I64, pointer, prefetch, splat
from stone.labels.voxels import VOXEL_M

BRICK = 4
BLOCK = 2048  # rays; a multiple of 8, so that a ray's position in its block determines its thinning
ALIKE = 8  # voxels; rays with about the same number of voxels are followed together
LOAD_RATIO = 0.5
AHEAD = 16  # bricks prefetched at once


@dataclass(frozen=True)
class CarveParameters:
    """Parameters of ray thinning.

    Neighbouring rays pass the same voxels near the sensor. In a sweep of more than `sparse_rays` rays, only one ray in
    eight therefore starts at the sensor. A second one starts at `thin_m`, two more at twice and the other four at three
    times that range. Each range still has more than one ray per voxel.

    Neighbouring sweeps overlap too. One sweep in N / `rays_per_sweep` is followed (N rays per sweep, rounded down), and
    at least one in `every_frame`.
    """

    max_range_m: float = 40.0
    thin_m: float = 8.0
    sparse_rays: int = 40_000
    every_frame: int = 5
    rays_per_sweep: int = 20_000

    def every(self, rays: int) -> int:
        """Return n to follow one sweep in n, for sweeps with this number of rays."""
        return max(1, min(self.every_frame, rays // self.rays_per_sweep))


@dataclass(frozen=True, eq=False)
class Observed:
    """`keys` (B,) sorted brick keys (lattice of `BRICK` voxels), `words` (B,) uint64 bits, `since` (B,) the first frame
    whose rays touched the brick.
    """

    keys: Keys
    words: NDArray[np.uint64]
    since: NDArray[np.int32]

    def where(self, kept: NDArray[np.bool_]) -> "Observed":
        """Return the bricks selected by `kept` (B,)."""
        return Observed(self.keys[kept], self.words[kept], self.since[kept])


NOTHING = Observed(np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, np.int32))


def union(parts: Sequence[Observed]) -> Observed:
    """Return the voxels that any of the parts observed."""
    keys = np.concatenate([part.keys for part in parts])
    words = np.concatenate([part.words for part in parts])
    since = np.concatenate([part.since for part in parts])
    order = np.argsort(keys, kind="stable")
    keys, words, since = keys[order], words[order], since[order]
    if len(keys) == 0:
        return Observed(keys, words, since)
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return Observed(keys[first], np.bitwise_or.reduceat(words, first), np.minimum.reduceat(since, first))


class Carver:
    """Follows the rays of sweep after sweep; `finish` returns the result.

    A sweep is carved into a dense window of bricks around the sensor, so that a step needs no look-up; the window is
    then merged into the result. The window has 19 MB up to 49 m, and eight times that up to 100 m; larger ranges raise
    ValueError.
    """

    def __init__(self, parameters: CarveParameters, slots: int = 1 << 16) -> None:
        self._parameters = parameters
        self._used = 0
        self._keys = np.full(slots, EMPTY, np.int64)
        self._words = np.zeros(slots, np.uint64)
        self._since = np.zeros(slots, np.int32)
        self._bits = _window_bits(parameters)
        bricks = 1 << 3 * self._bits
        self._window = np.zeros(bricks, np.uint64)
        self._is_touched, self._touched = np.zeros(bricks, np.uint8), np.empty(bricks + 1, np.int32)
        self._lanes = _room_for_lanes(parameters)

    def carve(
        self, points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64], frame: int = 0
    ) -> None:
        """Mark every voxel between `sensor_ego` (3,) and each of the points (N, 3), both ends included.

        Calls must be in frame order. Raises `off_lattice` for a pose that is not finite or off the lattice.
        """
        p = self._parameters
        sensor = map_from_ego @ sensor_ego
        check_reach(np.abs(sensor) + p.max_range_m, VOXEL_M)
        thin_m = p.thin_m if len(points_ego) > p.sparse_rays else 0.0
        reach = (p.max_range_m / VOXEL_M, thin_m / VOXEL_M)
        origin = sensor / VOXEL_M
        corner = np.floor(origin).astype(np.int64) // BRICK - _window_radius(p)
        view = (map_from_ego.as_matrix(), origin, corner * BRICK)
        _carve(points_ego, view, reach, (self._window, self._is_touched, self._bits), self._lanes)
        touched = _gather_touched(self._is_touched, self._touched)
        while self._used + touched > int(len(self._keys) * LOAD_RATIO):
            self._grow()
        window = (self._window, self._touched[:touched], self._bits)
        self._used += _join(window, corner, (self._keys, self._words, self._since), frame)

    def _grow(self) -> None:
        old = (self._keys, self._words, self._since)
        self._keys = np.full(2 * len(old[0]), EMPTY, np.int64)
        self._words = np.zeros(2 * len(old[0]), np.uint64)
        self._since = np.zeros(2 * len(old[0]), np.int32)
        _rehash(old, (self._keys, self._words, self._since))

    def finish(self) -> Observed:
        used = np.flatnonzero(self._keys != EMPTY)
        order = used[np.argsort(self._keys[used])]
        return Observed(self._keys[order], self._words[order], self._since[order])


def _window_radius(parameters: CarveParameters) -> int:
    """Return the maximum distance of a ray from the sensor in bricks, plus one for rounding."""
    return math.ceil(parameters.max_range_m / (VOXEL_M * BRICK)) + 1


def _window_bits(parameters: CarveParameters) -> int:
    """Return `bits` for a window of 2^bits bricks along each axis. Raises ValueError beyond `MOST_BITS`."""
    bits = (2 * _window_radius(parameters)).bit_length()
    if bits > MOST_BITS:
        raise ValueError(f"the longest ray is {parameters.max_range_m:g} m, beyond the reach of a window (100 m)")
    return bits


def _room_for_lanes(parameters: CarveParameters) -> tuple[NDArray[np.generic], ...]:
    """Return the buffers of a block: rays from `_aim` and for `follow`, their order, and the output."""
    most = math.ceil(math.sqrt(3) * parameters.max_range_m / VOXEL_M) + 3  # faces that a ray crosses, plus one
    rays, order = np.zeros((4, BLOCK)), (np.zeros(BLOCK, np.int32), np.zeros(most // ALIKE + 2, np.int64))
    lanes = np.zeros((TIMES, BLOCK + LANES), np.int64), np.zeros((CELLS, BLOCK + LANES), np.int32)
    return rays, *lanes, *order, np.zeros(most * LANES, np.int32)


@njit(cache=True, nogil=True, error_model="numpy")
def _carve(points, view, reach, window, room):  # type: ignore[no-untyped-def]
    """Follow all rays through the window, and record which of its bricks they touch."""
    (words, is_touched, bits), (rays, times, cells, ranks, ends, places) = window, room
    masks = axis_mask(bits, 0), axis_mask(bits, 1), axis_mask(bits, 2)
    for begin in range(0, points.shape[0], BLOCK):
        block = points[begin : begin + BLOCK]
        _aim(block, view[0], view[1], rays)
        count = _rank(rays, block.shape[0], reach, ranks, ends)
        _line_up(rays, reach, (view[1], view[2], bits), ranks[: block.shape[0]], (times, cells))
        _fill_lanes(count, times, cells)
        for first in range(0, count, LANES):
            _mark(places[: follow(times, cells, first, masks, places)], words, is_touched)


@njit(inline="always")
def _stretch(rays, p, reach):  # type: ignore[no-untyped-def]
    """Return the range of a block's ray to follow; empty if its length is not a number or beyond the reach."""
    level = 0 if p % 8 == 0 else 1 if p % 8 == 4 else 2 if p % 4 == 2 else 3
    return level * reach[1], min(rays[3, p], reach[0]) if rays[3, p] <= NEVER else -1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _rank(rays, count, reach, ranks, ends):  # type: ignore[no-untyped-def]
    """Write each ray's rank among the followed rays, by number of voxels (−1 if not followed); return their number."""
    ends[:] = 0
    followed = 0
    for p in range(count):
        start, end = _stretch(rays, p, reach)
        ranks[p] = -1
        if start < end:
            passed = (end - start) * (abs(rays[0, p]) + abs(rays[1, p]) + abs(rays[2, p]))
            ranks[p] = int(passed) // ALIKE
            ends[ranks[p] + 1] += 1
            followed += 1
    for kind in range(1, ends.size):
        ends[kind] += ends[kind - 1]
    for p in range(count):
        if ranks[p] >= 0:
            kind = ranks[p]
            ranks[p] = ends[kind]
            ends[kind] += 1
    return followed


@njit(cache=True, nogil=True, error_model="numpy")
def _aim(block, pose, origin, rays):  # type: ignore[no-untyped-def]
    """Write unit direction and length, in voxels, of the ray to each point."""
    m00, m01, m02, m03 = pose[0]
    m10, m11, m12, m13 = pose[1]
    m20, m21, m22, m23 = pose[2]
    o0, o1, o2 = origin
    for p in range(block.shape[0]):
        x, y, z = np.float64(block[p, 0]), np.float64(block[p, 1]), np.float64(block[p, 2])
        dx = (m00 * x + m01 * y + m02 * z + m03) / VOXEL_M - o0
        dy = (m10 * x + m11 * y + m12 * z + m13) / VOXEL_M - o1
        dz = (m20 * x + m21 * y + m22 * z + m23) / VOXEL_M - o2
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        rays[0, p], rays[1, p], rays[2, p], rays[3, p] = dx / length, dy / length, dz / length, length


@njit(cache=True, nogil=True, error_model="numpy")
def _line_up(rays, reach, view, ranks, lanes):  # type: ignore[no-untyped-def]
    """Write each followed ray at its rank: its entry into the lattice and its crossing times."""
    (origin, corner, bits), (times, cells) = view, lanes
    for p in range(ranks.size):
        rank = ranks[p]
        if rank < 0:
            continue
        start, end = _stretch(rays, p, reach)
        for axis in range(3):
            slope = rays[axis, p]
            at = origin[axis] + slope * start
            index = math.floor(at)
            times[axis, rank], times[3 + axis, rank] = set_off(slope, at - index, axis)
            cells[axis, rank] = share_of(index - corner[axis], bits, axis)
            cells[3 + axis, rank] = step_of(slope, bits, axis)
        times[END, rank] = end_of(end - start)


@njit(cache=True, nogil=True)
def _fill_lanes(count, times, cells):  # type: ignore[no-untyped-def]
    """Fill the lanes after the last ray with rays that stay at its start."""
    for lane in range(count, -(-count // LANES) * LANES):
        times[END, lane] = -1
        for row in range(CELLS):
            cells[row, lane] = cells[row, count - 1]


@njit(cache=True, nogil=True)
def _mark(places, words, is_touched):  # type: ignore[no-untyped-def]
    for p in range(places.size):
        bit = np.uint64(np.uint32(places[p]))
        is_touched[bit >> np.uint64(6)] = 1
        words[bit >> np.uint64(6)] |= np.uint64(1) << (bit & np.uint64(63))


@njit(cache=True, nogil=True)
def _gather_touched(is_touched, touched):  # type: ignore[no-untyped-def]
    """Write the touched bricks in order, and reset the marks; return their number."""
    count, eights = 0, is_touched.view(np.uint64)
    for eight in range(eights.size):
        if eights[eight] == 0:
            continue
        for brick in range(8 * eight, 8 * eight + 8):
            touched[count] = brick
            count += is_touched[brick]
        eights[eight] = 0
    return count


@njit(cache=True, nogil=True)
def _join(window, corner, table, frame):  # type: ignore[no-untyped-def]
    """Merge the touched bricks into the table, clear the window and return the number of bricks new in this frame."""
    (words, touched, bits), (keys, known, since) = window, table
    side = 1 << bits
    new, mask, own = 0, np.uint64(keys.size - 1), np.empty(touched.size, np.int64)
    for n in range(touched.size):
        brick = np.int64(touched[n])
        i, j, k = brick // (side * side), brick // side % side, brick % side
        own[n] = pack(i + corner[0], j + corner[1], k + corner[2])
    for n in range(touched.size):
        if n + AHEAD < touched.size:
            first = np.int64(scatter(own[n + AHEAD]) & mask)
            prefetch(keys, first)
            prefetch(known, first)
            prefetch(words, np.int64(touched[n + AHEAD]))
        key, brick = own[n], touched[n]
        slot = slot_of(keys, key)
        if keys[slot] == EMPTY:
            new += 1
            since[slot] = frame
        keys[slot] = key
        known[slot] |= words[brick]
        words[brick] = 0
    return new


@njit(cache=True, nogil=True)
def _rehash(old, new):  # type: ignore[no-untyped-def]
    for row in range(old[0].size):
        if old[0][row] != EMPTY:
            slot = slot_of(new[0], old[0][row])
            new[0][slot] = old[0][row]
            new[1][slot], new[2][slot] = old[1][row], old[2][row]


# Follows rays through the voxel lattice, `LANES` of them in parallel to hide latency. A window has 2^bits bricks along
# each axis, and a voxel's place in it is brick · 64 + bit (`stone.labels.observed_voxels`). Each axis has its own bits
# of a place, its share, and a step along the axis changes only these (Schrack, 1992). Rays that leave the window at one
# end enter it at the other. Time along a ray is counted in 2^-44 voxels, finer than the rounding of doubles. The lowest
# bits number the axis and direction, so that no two crossings coincide. Rays are stored side by side. `times` (7, R)
# are the next crossings of x, y, z, the time per voxel along each, and the end. `cells` (6, R) are the shares of x, y,
# z and their increments. Source: Amanatides & Woo (1987).


LANES = 16
TICKS = 2.0**44
AXIS_BITS = 3
NEVER = 2.0**14  # voxels; beyond the end of any ray
TIMES, CELLS, END = 7, 6, 6
MOST_BITS = 8  # places have 31 bits, 6 of them within a brick


def _follow_of(typing_context: Any, times: Any, cells: Any, first: Any, masks: Any, places: Any) -> Any:
    """Write the places of all voxels on `LANES` rays from `first` to `places`; return the number written.

    Each step writes `LANES` places until the longest ray ends or the room is used up; a finished ray stays in its last
    voxel. `masks` are the bits of each axis.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        times, cells, first, masks, places = arguments
        wide, narrow = ir.VectorType(I64, LANES), ir.VectorType(I32, LANES)
        rows = _rows(context, builder, (signature.args[0], times), (first, TIMES), wide)
        crossings, lengths, end = rows[:3], rows[3:6], rows[END]
        rows = _rows(context, builder, (signature.args[1], cells), (first, CELLS), narrow)
        shares, steps = rows[:3], rows[3:]
        kept = [splat(builder, builder.trunc(builder.extract_value(masks, axis), I32), narrow) for axis in range(3)]
        room = context.make_array(signature.args[4])(context, builder, places).nitems
        before, step, ended = (builder.block, *(builder.append_basic_block(name) for name in ("step", "ended")))
        builder.branch(step)
        builder.position_at_end(step)
        following = [_carried(builder, before, value) for value in crossings]
        at = [_carried(builder, before, value) for value in shares]
        count = _carried(builder, before, ir.Constant(I64, 0))
        target = pointer(context, builder, (signature.args[4], places), count, narrow, LANES)
        builder.store(builder.or_(at[0], builder.or_(at[1], at[2])), target, 4)
        least = _least(builder, following[0], _least(builder, following[1], following[2]))
        goes_on = builder.icmp_signed("<=", least, end)
        written = builder.add(count, ir.Constant(I64, LANES))
        last = builder.block  # not `step` if indices are checked
        count.add_incoming(written, last)
        for axis in range(3):
            is_next = builder.and_(builder.icmp_signed("==", least, following[axis]), goes_on)
            later = builder.add(following[axis], lengths[axis])
            moved = builder.and_(builder.add(at[axis], steps[axis]), kept[axis])
            following[axis].add_incoming(builder.select(is_next, later, following[axis]), last)
            at[axis].add_incoming(builder.select(is_next, moved, at[axis]), last)
        are_left = builder.bitcast(goes_on, ir.IntType(LANES))
        is_any_left = builder.icmp_unsigned("!=", are_left, ir.Constant(are_left.type, 0))
        has_room = builder.icmp_signed("<=", builder.add(written, ir.Constant(I64, LANES)), room)
        builder.cbranch(builder.and_(is_any_left, has_room), step, ended)
        builder.position_at_end(ended)
        return written

    return types.int64(times, cells, types.int64, masks, places), emit


def _rows(context: Any, builder: Any, table: tuple[Any, Any], part: tuple[Any, int], lanes: Any) -> list[Any]:
    """Return the lanes of a table's columns, for the rows in `part`."""
    columns = builder.extract_value(context.make_array(table[0])(context, builder, table[1]).shape, 1)
    places = (builder.add(builder.mul(columns, ir.Constant(I64, row)), part[0]) for row in range(part[1]))
    return [builder.load(pointer(context, builder, table, address, lanes, LANES), align=4) for address in places]


def _carried(builder: Any, before: Any, value: Any) -> Any:
    """Return a loop variable that starts as `value`."""
    carried = builder.phi(value.type)
    carried.add_incoming(value, before)
    return carried


def _least(builder: Any, one: Any, other: Any) -> Any:
    return builder.select(builder.icmp_signed("<", one, other), one, other)


follow: Any = intrinsic(_follow_of)


@njit(inline="always")
def axis_mask(bits, axis):  # type: ignore[no-untyped-def]
    """Return the bits of x, y or z in the places of a window with 2^bits bricks along each axis."""
    return ((1 << bits) - 1) << (6 + (2 - axis) * bits) | 3 << (2 * (2 - axis))


@njit(inline="always")
def share_of(index, bits, axis):  # type: ignore[no-untyped-def]
    """Return the share of a voxel's index along an axis, counted from the window's corner."""
    share = (index >> 2) << (6 + (2 - axis) * bits) | (index & 3) << (2 * (2 - axis))
    return share & axis_mask(bits, axis)


@njit(inline="always")
def step_of(slope, bits, axis):  # type: ignore[no-untyped-def]
    """Return the increment of a ray's share per step along this axis; upwards, it carries over the other axes' bits."""
    unit = 1 << (2 * (2 - axis))
    return unit + ~axis_mask(bits, axis) if slope > 0 else -unit


@njit(inline="always")
def set_off(slope, offset, axis):  # type: ignore[no-untyped-def]
    """Return when a ray that starts at `offset` in its voxel leaves it along this axis, and the time per voxel."""
    is_up = slope > 0
    each = abs(1.0 / slope) if abs(slope) > 1e-12 else NEVER
    first = (1.0 - offset if is_up else offset) * each
    return (int(min(first, NEVER) * TICKS) << AXIS_BITS) + 2 * axis + is_up, int(min(each, NEVER) * TICKS) << AXIS_BITS


@njit(inline="always")
def end_of(length):  # type: ignore[no-untyped-def]
    """Return the end time of a ray with this length in voxels."""
    return int(length * TICKS) << AXIS_BITS | (1 << AXIS_BITS) - 1
