"""Fills pinholes that a rotated grid leaves in closed surfaces, for every yaw, pitch and roll.

**Conventions.** Positions as in `stone.labels.crops`. Only free voxels that a labelled voxel touches are considered, in
grid order, each back along x, y and z.
"""

import numpy as np
from numba import njit

from stone.kernels.lanes import differs, lowest
from stone.labels.grid import HIGH, LOW, OCCUPIED

FRACTION_BITS = 20
ONE = 1 << FRACTION_BITS
CLASS_1, CLASS_2, LABELLED, SEEN = range(4)  # words of a row: bits `LOW`, `HIGH`, `OCCUPIED` and `OBSERVED`
NOT_ASKED = np.zeros((0, 0, 0, 3), np.int32)  # the source voxels of closed gaps are not requested


@njit(inline="always")
def parted(position, back, slope):  # type: ignore[no-untyped-def]
    """Return a word: bit n is set if the n-th voxel of a column from `position` lies in another map voxel than its
    neighbour at `back`.
    """
    return differs(np.int32(position & (ONE - 1)), np.int32(back), np.int32(slope), np.int32(FRACTION_BITS))


@njit(cache=True, nogil=True)
def close_row(voxels, placement, row, out):  # type: ignore[no-untyped-def]
    """Write the classes of row `a` with closed gaps in it and the previous row; return the number of closed voxels.

    `row` is (a, rows, ways): rows as fetched by `stone.labels.crops`, and a buffer for the ways back of all voxels of a
    row; `out` is (ones, twos, observed, taken).
    """
    a, rows, ways = row
    count = _write_classes(placement, (a, rows), out, ways)
    count = _keep_crossing(voxels, placement, a, ways, count)
    return _fill(voxels, placement, a, ways[:count], out)


@njit(cache=True, nogil=True)
def _write_classes(placement, row, out, ways):  # type: ignore[no-untyped-def]
    """Write the labelled and observed voxels, and the ways back that may cross a surface, in grid order as 128 b + 4 c
    + axis; return the number of ways.

    Values are copied to local names first, because the compiler cannot exclude that an output overlaps them.
    """
    (start, step), (a, rows), (low_plane, high_plane, observed, _) = placement, row, out
    along_x = step[0, 0], step[1, 0], step[2, 0]
    along_y = step[0, 1], step[1, 1], step[2, 1]
    along_z = step[0, 2], step[1, 2], step[2, 2]
    begin = start[0] + a * along_x[0], start[1] + a * along_x[1], start[2] + a * along_x[2]
    here, before, count = rows[a & 1], rows[(a + 1) & 1], 0
    for b in range(here.shape[0]):
        occupied = here[b, LABELLED]
        low_plane[a, b], high_plane[a, b] = here[b, CLASS_1] & occupied, here[b, CLASS_2] & occupied
        observed[a, b] = here[b, SEEN]
        near, beside = here[b, CLASS_1] & ~occupied, here[b, CLASS_2] & ~occupied
        if near == 0:
            continue
        line = begin[0] + b * along_y[0], begin[1] + b * along_y[1], begin[2] + b * along_y[2]
        back_x = back_y = np.uint32(0)
        if a > 0:
            back_x = near & ~before[b, LABELLED] & _slants(line, along_x, along_z, beside)
        if b > 0:
            back_y = near & ~here[b - 1, LABELLED] & _slants(line, along_y, along_z, beside)
        back_z = near & (~occupied << np.uint32(1)) & _slants(line, along_z, along_z, beside)
        left = back_x | back_y | back_z
        while left:
            c = lowest(left)
            left &= left - np.uint32(1)
            for axis, back in enumerate((back_x, back_y, back_z)):
                ways[count] = b << 7 | c << 2 | axis
                count += (back >> np.uint32(c)) & np.uint32(1)
    return count


@njit(inline="always")
def _slants(line, back, up, beside):  # type: ignore[no-untyped-def]
    """Return from which voxels of a column the way `back` enters more than one map voxel; `up` leads along the column.

    If it stays at one height, only a labelled voxel `beside` can be crossed.
    """
    in_x = parted(line[0], back[0], up[0])
    in_y = parted(line[1], back[1], up[1])
    in_z = parted(line[2], back[2], up[2])
    return (in_x & in_y & beside) | ((in_x | in_y) & in_z)


@njit(inline="always")
def _ends(placement, a, way):  # type: ignore[no-untyped-def]
    """Return both ends of a way back: the free voxel before, and the free voxel itself."""
    start, step = placement
    b, c, axis = way >> 7, (way >> 2) & 31, way & 3
    x = start[0] + a * step[0, 0] + b * step[0, 1] + c * step[0, 2]
    y = start[1] + a * step[1, 0] + b * step[1, 1] + c * step[1, 2]
    z = start[2] + a * step[2, 0] + b * step[2, 1] + c * step[2, 2]
    return (x - step[0, axis], y - step[1, axis], z - step[2, axis]), (x, y, z)


@njit(inline="always")
def _layer(number, layers):  # type: ignore[no-untyped-def]
    """Return the window's layer of a voxel along one axis; voxels outside have the outermost layer."""
    return min(max(number + 1, 0), layers - 1)


@njit(cache=True, nogil=True)
def _keep_crossing(voxels, placement, a, ways, count):  # type: ignore[no-untyped-def]
    """Keep the ways that may cross a labelled voxel, in their order; return their number.

    A way can only cross voxels of the block between its two free ends: its six other corners, fewer if the way stays
    within a layer.
    """
    x, y, z = voxels.shape
    kept = 0
    for at in range(count):
        (u, v, w), (eu, ev, ew) = _ends(placement, a, ways[at])
        i, j, k = _layer(u >> FRACTION_BITS, x), _layer(v >> FRACTION_BITS, y), _layer(w >> FRACTION_BITS, z)
        ei, ej, ek = _layer(eu >> FRACTION_BITS, x), _layer(ev >> FRACTION_BITS, y), _layer(ew >> FRACTION_BITS, z)
        crossed = voxels[ei, j, k] | voxels[i, ej, k] | voxels[i, j, ek]
        crossed |= voxels[ei, ej, k] | voxels[ei, j, ek] | voxels[i, ej, ek]
        ways[kept] = ways[at]
        kept += (crossed & OCCUPIED) != 0
    return kept


@njit(cache=True, nogil=True)
def _fill(voxels, placement, a, ways, out):  # type: ignore[no-untyped-def]
    """On each way between two free centres, give the crossed class to the nearer voxel; return the number of voxels
    that were free before.
    """
    (low_plane, high_plane, _, taken), filled = out, 0
    for way in ways:
        end, begin = _ends(placement, a, way)
        crossed, ratio, cell = _stepped_over(voxels, end, begin)
        if crossed & OCCUPIED == 0:
            continue
        is_before, axis = ratio < 0.5, way & 3
        at, b, c = a - (is_before & (axis == 0)), (way >> 7) - (is_before & (axis == 1)), (way >> 2) & 31
        c -= is_before & (axis == 2)
        bit = np.uint32(1) << np.uint32(c)
        filled += (low_plane[at, b] | high_plane[at, b]) & bit == 0
        low_plane[at, b] = (low_plane[at, b] & ~bit) | (bit if crossed & LOW else np.uint32(0))
        high_plane[at, b] = (high_plane[at, b] & ~bit) | (bit if crossed & HIGH else np.uint32(0))
        if taken.size:
            taken[at, b, c, 0], taken[at, b, c, 1], taken[at, b, c, 2] = cell
    return filled


@njit(inline="always")
def _stepped_over(voxels, a, b):  # type: ignore[no-untyped-def]
    """Return (bits, position from a = 0 to b = 1, voxel) of the first labelled voxel between two free ones, if any.

    A way leaves a layer at most once along each axis, so it crosses at most two voxels.
    """
    i, j, k = a[0] >> FRACTION_BITS, a[1] >> FRACTION_BITS, a[2] >> FRACTION_BITS
    ei, ej, ek = b[0] >> FRACTION_BITS, b[1] >> FRACTION_BITS, b[2] >> FRACTION_BITS
    ti = ((max(i, ei) << FRACTION_BITS) - a[0]) / (b[0] - a[0]) if ei != i else 2.0
    tj = ((max(j, ej) << FRACTION_BITS) - a[1]) / (b[1] - a[1]) if ej != j else 2.0
    tk = ((max(k, ek) << FRACTION_BITS) - a[2]) / (b[2] - a[2]) if ek != k else 2.0
    first = min(ti, tj, tk)
    in_x = ti == first
    in_y = (not in_x) & (tj == first)
    in_z = (not in_x) & (not in_y)
    i, j, k = ei if in_x else i, ej if in_y else j, ek if in_z else k
    ti, tj, tk = 2.0 if in_x else ti, 2.0 if in_y else tj, 2.0 if in_z else tk
    second = min(ti, tj, tk)
    in_x = ti == second
    in_y = (not in_x) & (tj == second)
    in_z = (not in_x) & (not in_y)
    ni, nj, nk = ei if in_x else i, ej if in_y else j, ek if in_z else k
    x, y, z = voxels.shape
    first_voxel = voxels[_layer(i, x), _layer(j, y), _layer(k, z)]
    other = voxels[_layer(ni, x), _layer(nj, y), _layer(nk, z)]
    if first_voxel & OCCUPIED:
        return first_voxel, first, (i, j, k)
    return other, second, (ni, nj, nk)
