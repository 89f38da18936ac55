"""Visibility for many frames at once: every sight line is looked up once and followed for a batch of frames.

**Conventions.** As in `stone.labels.visibility`, which defines the lines; a frame is one lane. Frames are independent:
results do not depend on the batch size.
"""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic

from stone.kernels.lanes import I8, I32, bits_of, pointer, splat, transpose
from stone.labels.columns import Words
from stone.labels.visibility import (
    AT_SOURCE,
    FRAMED_HEIGHT,
    IN_IMAGE,
    OPEN,
    SIDE_BIT,
    VOXEL_BITS,
    SightLines,
    framed,
    ways,
)
from stone_base.label_grid import PAPER, LabelGrid

LANES = 32
BESIDE = 8  # columns; the row length of every grid is a multiple
VOXEL_MASK, WAY_MASK = np.uint32((1 << VOXEL_BITS) - 1), np.uint32(31)


class SightBatch:
    """Follows the sight lines of a robot's cameras through up to `LANES` frames at a time; uses 90 MB."""

    def __init__(self, cameras: Sequence[SightLines], grid: LabelGrid = PAPER) -> None:
        voxels = prod(framed(grid.shape)) if cameras else 0
        self._cameras, self._sides = cameras, grid.shape[:2]
        self._ways = ways(grid.shape)
        self._open = np.full(voxels * LANES, OPEN, np.uint8)
        self._free, self._seen = np.zeros(voxels, np.uint32), np.zeros(voxels, np.uint32)

    def visible(self, occupied: Words) -> Words:
        """Return the voxels (F, X, Y) that any camera sees past the labelled voxels, as columns; F up to `LANES`."""
        if not self._cameras:
            return np.zeros_like(occupied)
        frames = len(occupied)
        batch = np.zeros((LANES, occupied[0].size), np.uint32)
        batch[:frames] = occupied.reshape(frames, -1)
        _by_voxel(batch, self._sides, self._free)
        self._seen[:] = 0
        for lines in self._cameras:
            _look((lines.place, lines.weight), self._ways, (self._free, self._open, self._seen))
            _look_at_sides(lines.place, self._ways, (self._free, self._open, self._seen))
        _by_frame(self._seen, self._sides, batch)
        return batch[:frames].reshape(occupied.shape)


def _reach_of(typing_context: Any, ways: Any, places: Any, weights: Any, free: Any) -> Any:
    """Return the openness of the ways through voxel places[4], from the four before it, and a word: bit n is set if
    lane n is at least half open.

    A way continues only in the lanes that are set in `free`.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, places, weights, free = arguments
        lanes, wide = ir.VectorType(I8, LANES), ir.VectorType(ir.IntType(16), LANES)
        total = ir.Constant(wide, [0] * LANES)
        for corner in range(4):
            index = builder.extract_value(places, corner)
            row = builder.load(pointer(context, builder, (signature.args[0], array), index, lanes, LANES), align=1)
            weight = builder.zext(builder.extract_value(weights, corner), ir.IntType(16))
            total = builder.add(total, builder.mul(builder.zext(row, wide), splat(builder, weight, wide)))
        reached = builder.udiv(total, ir.Constant(wide, [OPEN] * LANES))
        seen = builder.icmp_unsigned(">=", reached, ir.Constant(wide, [OPEN // 2] * LANES))
        onward = builder.select(
            builder.bitcast(free, bits_of(LANES)), builder.trunc(reached, lanes), ir.Constant(lanes, [0] * LANES)
        )
        index = builder.extract_value(places, 4)
        builder.store(onward, pointer(context, builder, (signature.args[0], array), index, lanes, LANES), 1)
        return builder.bitcast(seen, I32)

    return types.uint32(ways, places, weights, types.uint32), emit


def _half_open_of(typing_context: Any, ways: Any, place: Any) -> Any:
    """Return a word: bit n is set if the way from ways[place] is at least half open in lane n."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.VectorType(I8, LANES)
        row = builder.load(
            pointer(context, builder, (signature.args[0], arguments[0]), arguments[1], lanes, LANES), align=1
        )
        return builder.bitcast(builder.icmp_unsigned(">=", row, ir.Constant(lanes, [OPEN // 2] * LANES)), I32)

    return types.uint32(ways, types.int64), emit


_reach: Any = intrinsic(_reach_of)
_half_open: Any = intrinsic(_half_open_of)


@njit(cache=True, nogil=True)
def _look(lines, ways, state):  # type: ignore[no-untyped-def]
    (voxels, weight), (free, way, seen) = lines, state
    for s in range(voxels.size):
        voxel = np.int64(voxels[s] & VOXEL_MASK)
        code = (voxels[s] >> np.uint32(VOXEL_BITS)) & WAY_MASK
        at = voxel * LANES
        if code == AT_SOURCE:
            for lane in range(LANES):
                way[at + lane] = OPEN if (free[voxel] >> np.uint32(lane)) & np.uint32(1) else 0
            reached = np.uint32(0xFFFFFFFF)
        else:
            first = at + ways[code, 0] * LANES
            second, third = ways[code, 1] * LANES, ways[code, 2] * LANES
            places = (first, first + second, first + third, first + second + third, at)
            weights = (weight[s, 0], weight[s, 1], weight[s, 2], weight[s, 3])
            reached = _reach(way, places, weights, free[voxel])
        if voxels[s] & IN_IMAGE:
            seen[voxel] |= reached


@njit(cache=True, nogil=True)
def _look_at_sides(voxels, ways, state):  # type: ignore[no-untyped-def]
    """Mark labelled voxels as seen if a line ends on their side; the ways have been followed before."""
    free, way, seen = state
    for s in range(voxels.size):
        voxel = np.int64(voxels[s] & VOXEL_MASK)
        labelled = ~free[voxel]
        if labelled == 0 or not voxels[s] & IN_IMAGE:
            continue
        code = (voxels[s] >> np.uint32(VOXEL_BITS)) & WAY_MASK
        for axis in range(3):
            if (voxels[s] >> np.uint32(SIDE_BIT + axis)) & np.uint32(1):
                seen[voxel] |= labelled & _half_open(way, (voxel + ways[code, 3 + axis]) * LANES)


@njit(cache=True, nogil=True)
def _by_voxel(batch, sides, free):  # type: ignore[no-untyped-def]
    """Convert columns per frame to lanes per voxel: the frames in which each voxel is free.

    `BESIDE` columns (one cache line) are converted at a time, because the words of consecutive frames evict each other
    from the cache.
    """
    near = np.empty((BESIDE, LANES), np.uint32)
    for a in range(sides[0]):
        for b in range(0, sides[1], BESIDE):
            column = a * sides[1] + b
            for lane in range(LANES):
                for n in range(BESIDE):
                    near[n, lane] = ~batch[lane, column + n]
            for n in range(BESIDE):
                transpose(near, n * LANES, free, ((a + 1) * (sides[1] + 2) + b + n + 1) * FRAMED_HEIGHT + 1)


@njit(cache=True, nogil=True)
def _by_frame(seen, sides, batch):  # type: ignore[no-untyped-def]
    """Convert seen voxels from lanes to columns."""
    near = np.empty((BESIDE, LANES), np.uint32)
    for a in range(sides[0]):
        for b in range(0, sides[1], BESIDE):
            column = a * sides[1] + b
            for n in range(BESIDE):
                transpose(seen, ((a + 1) * (sides[1] + 2) + b + n + 1) * FRAMED_HEIGHT + 1, near, n * LANES)
            for lane in range(LANES):
                for n in range(BESIDE):
                    batch[lane, column + n] = near[n, lane]
