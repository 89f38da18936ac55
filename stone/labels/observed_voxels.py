"""Observed voxels: every voxel that a LiDAR ray reached or passed.

**Conventions.** The set is kept as bricks of 4 × 4 × 4 voxels, one bit each in a uint64 word, so marking a voxel is
idempotent and sets from different sweeps join by OR: order and grouping do not matter. Bit (x·4 + y)·4 + z. Each
brick also keeps the first frame whose rays touched it.
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
BLOCK = 2048  # rays; a multiple of 8, so that a ray's place in its block says how it is thinned
ALIKE = 8  # voxels; rays that pass about as many are followed together
LOAD_RATIO = 0.5
AHEAD = 16  # bricks: so many are asked for at once


@dataclass(frozen=True)
class CarveParameters:
    """How rays are followed. Neighbouring rays pass through the same voxels near the sensor, so in a sweep of more than
    `sparse_rays` one ray in eight is followed from the sensor on, one more in eight from `thin_m` on, two more from
    twice and the other four from three times that range: at each there is still more than one ray per voxel.

    Neighbouring sweeps overlap alike, so of sweeps with N rays one in N / `rays_per_sweep` is followed, rounded down,
    and at least one in `every_frame`."""

    max_range_m: float = 40.0
    thin_m: float = 8.0
    sparse_rays: int = 40_000
    every_frame: int = 5
    rays_per_sweep: int = 20_000

    def every(self, rays: int) -> int:
        """Return n to follow one sweep in n, if a sweep has this number of rays."""
        return max(1, min(self.every_frame, rays // self.rays_per_sweep))


@dataclass(frozen=True, eq=False)
class Observed:
    """`keys` (B,) sorted brick keys (lattice of `BRICK` voxels), `words` (B,) uint64 bits, `since` (B,) the first frame
    whose rays touched the brick."""

    keys: Keys
    words: NDArray[np.uint64]
    since: NDArray[np.int32]

    def where(self, kept: NDArray[np.bool_]) -> "Observed":
        """Return the bricks selected by `kept` (B,)."""
        return Observed(self.keys[kept], self.words[kept], self.since[kept])


NOTHING = Observed(np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, np.int32))


def union(parts: Sequence[Observed]) -> Observed:
    """What any of the parts observed."""
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
    """Follows the rays of sweep after sweep, then `finish`.

    A sweep is carved into a dense window of bricks around the sensor, whose bits are then joined to what is known: a
    step costs no look-up. The window is 19 MB up to 49 m, and eight times as large up to 100 m; ValueError beyond.
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
        """Mark every voxel on the way from `sensor_ego` (3,) to each of the points (N, 3), both ends included.

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
    """How many bricks a ray may come away from that of the sensor, and one for rounding."""
    return math.ceil(parameters.max_range_m / (VOXEL_M * BRICK)) + 1


def _window_bits(parameters: CarveParameters) -> int:
    """The window has 2^bits bricks along each axis. Raises ValueError beyond `MOST_BITS`."""
    bits = (2 * _window_radius(parameters)).bit_length()
    if bits > MOST_BITS:
        raise ValueError(f"the longest ray is {parameters.max_range_m:g} m, beyond the reach of a window (100 m)")
    return bits


def _room_for_lanes(parameters: CarveParameters) -> tuple[NDArray[np.generic], ...]:
    """Rays of a block as `_aim` makes them and as `follow` takes them, how they are ordered, and what it writes."""
    most = math.ceil(math.sqrt(3) * parameters.max_range_m / VOXEL_M) + 3  # faces that a ray crosses, and one
    rays, order = np.zeros((4, BLOCK)), (np.zeros(BLOCK, np.int32), np.zeros(most // ALIKE + 2, np.int64))
    lanes = np.zeros((TIMES, BLOCK + LANES), np.int64), np.zeros((CELLS, BLOCK + LANES), np.int32)
    return rays, *lanes, *order, np.zeros(most * LANES, np.int32)


@njit(cache=True, nogil=True, error_model="numpy")
def _carve(points, view, reach, window, room):  # type: ignore[no-untyped-def]
    """Follow all rays through the window, and note which of its bricks they touch."""
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
    """From where to where a ray of a block is followed; one whose length is no number, or out of reach, to before its
    start."""
    level = 0 if p % 8 == 0 else 1 if p % 8 == 4 else 2 if p % 4 == 2 else 3
    return level * reach[1], min(rays[3, p], reach[0]) if rays[3, p] <= NEVER else -1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _rank(rays, count, reach, ranks, ends):  # type: ignore[no-untyped-def]
    """The place of each ray among those followed, by how many voxels it passes: −1 where it is not; how many are."""
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
    """Unit direction and length, in voxels, of the ray to each point."""
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
    """Each ray that is followed, at its place: where it enters the lattice, and when it crosses what."""
    (origin, corner, bits), (times, cells) = view, lanes
    for p in range(ranks.size):
        place = ranks[p]
        if place < 0:
            continue
        start, end = _stretch(rays, p, reach)
        for axis in range(3):
            slope = rays[axis, p]
            at = origin[axis] + slope * start
            index = math.floor(at)
            times[axis, place], times[3 + axis, place] = set_off(slope, at - index, axis)
            cells[axis, place] = share_of(index - corner[axis], bits, axis)
            cells[3 + axis, place] = step_of(slope, bits, axis)
        times[END, place] = end_of(end - start)


@njit(cache=True, nogil=True)
def _fill_lanes(count, times, cells):  # type: ignore[no-untyped-def]
    """The lanes behind the last ray stay where that begins."""
    for place in range(count, -(-count // LANES) * LANES):
        times[END, place] = -1
        for row in range(CELLS):
            cells[row, place] = cells[row, count - 1]


@njit(cache=True, nogil=True)
def _mark(places, words, is_touched):  # type: ignore[no-untyped-def]
    for p in range(places.size):
        place = np.uint64(np.uint32(places[p]))
        is_touched[place >> np.uint64(6)] = 1
        words[place >> np.uint64(6)] |= np.uint64(1) << (place & np.uint64(63))


@njit(cache=True, nogil=True)
def _gather_touched(is_touched, touched):  # type: ignore[no-untyped-def]
    """The bricks that were touched, in order, and nothing is afterwards; how many they are."""
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


# Rays through the voxel lattice, `LANES` of them in step: one alone waits for each of its steps, many do not.
#
# **Conventions.** A window of bricks has 2^bits of them along each axis, and a voxel's place in it is brick · 64 + bit
# (`stone.labels.observed_voxels`): so each axis has bits of its own in a place, its share, and a step along it adds to
# these alone (Schrack, 1992). What leaves the window at one end enters it at the other.
#
# Along a ray time is counted in 2^-44 voxels, finer than doubles are added up along it; the lowest bits are a number
# of the axis and the way along it, so that no two crossings come at one time. Rays stand side by side: `times` (7, R)
# are the next crossings of x, y, z, how long a voxel takes along each, and the end; `cells` (6, R) the shares of x, y,
# z and what a step adds to each.
#
# Source: Amanatides & Woo (1987).


LANES = 16
TICKS = 2.0**44
AXIS_BITS = 3
NEVER = 2.0**14  # voxels; further than any ray is followed
TIMES, CELLS, END = 7, 6, 6
MOST_BITS = 8  # places have 31 bits, of which 6 are within a brick


def _follow_of(typing_context: Any, times: Any, cells: Any, first: Any, masks: Any, places: Any) -> Any:
    """Write the places of all voxels that the `LANES` rays from `first` on pass to `places`; how many it wrote.

    `LANES` are written for each step of the longest: one that has ended stays where it is. No more than there is room
    for. `masks` are the bits of each axis.
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
        last = builder.block  # not `step` where indices are checked
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
    """Of a table the lanes from a column on, as many rows of it as `part` says."""
    columns = builder.extract_value(context.make_array(table[0])(context, builder, table[1]).shape, 1)
    places = (builder.add(builder.mul(columns, ir.Constant(I64, row)), part[0]) for row in range(part[1]))
    return [builder.load(pointer(context, builder, table, place, lanes, LANES), align=4) for place in places]


def _carried(builder: Any, before: Any, value: Any) -> Any:
    """A value that each step of a loop hands to the next, `value` to the first."""
    carried = builder.phi(value.type)
    carried.add_incoming(value, before)
    return carried


def _least(builder: Any, one: Any, other: Any) -> Any:
    return builder.select(builder.icmp_signed("<", one, other), one, other)


follow: Any = intrinsic(_follow_of)


@njit(inline="always")
def axis_mask(bits, axis):  # type: ignore[no-untyped-def]
    """The bits of x, y or z in the places of a window with 2^bits bricks along each axis."""
    return ((1 << bits) - 1) << (6 + (2 - axis) * bits) | 3 << (2 * (2 - axis))


@njit(inline="always")
def share_of(index, bits, axis):  # type: ignore[no-untyped-def]
    """What a voxel's index along an axis, counted from the window's corner, is of its place."""
    share = (index >> 2) << (6 + (2 - axis) * bits) | (index & 3) << (2 * (2 - axis))
    return share & axis_mask(bits, axis)


@njit(inline="always")
def step_of(slope, bits, axis):  # type: ignore[no-untyped-def]
    """What a step of a ray along this axis adds to its share; up, it carries over the bits of the others."""
    unit = 1 << (2 * (2 - axis))
    return unit + ~axis_mask(bits, axis) if slope > 0 else -unit


@njit(inline="always")
def set_off(slope, offset, axis):  # type: ignore[no-untyped-def]
    """When a ray that begins at `offset` in its voxel leaves it along this axis, and how long a voxel takes it."""
    is_up = slope > 0
    each = abs(1.0 / slope) if abs(slope) > 1e-12 else NEVER
    first = (1.0 - offset if is_up else offset) * each
    return (int(min(first, NEVER) * TICKS) << AXIS_BITS) + 2 * axis + is_up, int(min(each, NEVER) * TICKS) << AXIS_BITS


@njit(inline="always")
def end_of(length):  # type: ignore[no-untyped-def]
    """The time after which a ray of so many voxels is followed no further."""
    return int(length * TICKS) << AXIS_BITS | (1 << AXIS_BITS) - 1
