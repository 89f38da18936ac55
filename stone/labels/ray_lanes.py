"""Rays through the voxel lattice, `LANES` of them in step: one alone waits for each of its steps, many do not.

**Conventions.** A window of bricks has 2^bits of them along each axis, and a voxel's place in it is brick · 64 + bit
(`stone.labels.observed_voxels`): so each axis has bits of its own in a place, its share, and a step along it adds to
these alone (Schrack, 1992). What leaves the window at one end enters it at the other.

Along a ray time is counted in 2^-44 voxels, finer than doubles are added up along it; the lowest bits are a number of
the axis and the way along it, so that no two crossings come at one time. Rays stand side by side: `times` (7, R) are
the next crossings of x, y, z, how long a voxel takes along each, and the end; `cells` (6, R) the shares of x, y, z and
what a step adds to each.

Source: Amanatides & Woo (1987).
"""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic

from stone.kernels.lanes import I32, I64, pointer, splat

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
