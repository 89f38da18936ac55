"""Fills pinholes that a turned grid leaves in closed surfaces, whatever the yaw, pitch and roll.

**Conventions.** Positions as in `stone.labels.crops`. Only free voxels are looked at that a labelled one touches, in
the order of the grid, each back along x, y and z.
"""

import numpy as np
from numba import njit

from stone.kernels.lanes import differs, lowest
from stone.labels.grid import BELOW, HIGH, LOW, OBSERVED, OCCUPIED

FRACTION_BITS = 20
ONE = 1 << FRACTION_BITS
NOT_ASKED = np.zeros((0, 0, 0, 3), np.int32)  # nobody wants to know which voxel closed a gap


@njit(inline="always")
def parted(position, back, slope):  # type: ignore[no-untyped-def]
    """Bit n: the n-th voxel of a column from `position` on is in another voxel of the map than what lies `back`."""
    return differs(np.int32(position & (ONE - 1)), np.int32(back), np.int32(slope), np.int32(FRACTION_BITS))


@njit(cache=True, nogil=True)
def close_row(planes, place, row, out):  # type: ignore[no-untyped-def]
    """Write the classes of row `a`, closing what they and the row before step over.

    `row` is (a, cells), the latter as `stone.labels.crops` fetches them; `out` is (ones, twos, observed, taken). Steps
    are read into names first: for all the compiler knows, an output may lie over them.
    """
    (start, step), (a, cells), (ones, twos, observed, _) = place, row, out
    along_x = step[0, 0], step[1, 0], step[2, 0]
    along_y = step[0, 1], step[1, 1], step[2, 1]
    along_z = step[0, 2], step[1, 2], step[2, 2]
    begin = start[0] + a * along_x[0], start[1] + a * along_x[1], start[2] + a * along_x[2]
    for b in range(cells.shape[1]):
        occupied = cells[a, b, OCCUPIED]
        ones[a, b], twos[a, b] = cells[a, b, LOW] & occupied, cells[a, b, HIGH] & occupied
        observed[a, b] = cells[a, b, OBSERVED]
        near, beside = cells[a, b, LOW] & ~occupied, cells[a, b, HIGH] & ~occupied
        if near == 0:
            continue
        line = begin[0] + b * along_y[0], begin[1] + b * along_y[1], begin[2] + b * along_y[2]
        back_x = back_y = np.uint32(0)
        if a > 0:
            back_x = near & ~cells[a - 1, b, OCCUPIED] & _slants(line, along_x, along_z, beside)
        if b > 0:
            back_y = near & ~cells[a, b - 1, OCCUPIED] & _slants(line, along_y, along_z, beside)
        back_z = near & (~occupied << np.uint32(1)) & _slants(line, along_z, along_z, beside)
        left = back_x | back_y | back_z
        while left:
            c = lowest(left)
            left &= left - np.uint32(1)
            at = (line[0] + c * along_z[0], line[1] + c * along_z[1], line[2] + c * along_z[2])
            bit = np.uint32(1) << np.uint32(c)
            for axis in range(3):
                back = back_x if axis == 0 else back_y if axis == 1 else back_z
                if back & bit and _steps_over(planes, at, (step, axis)):
                    _fill(planes, at, (step, axis), (a, b, c), out)


@njit(inline="always")
def _slants(line, back, up, beside):  # type: ignore[no-untyped-def]
    """From which voxels of a column the way `back` enters more than one voxel of the map; `up` leads along the column.

    When it stays at one height, only a labelled voxel `beside` can be in the way.
    """
    in_x = parted(line[0], back[0], up[0])
    in_y = parted(line[1], back[1], up[1])
    in_z = parted(line[2], back[2], up[2])
    return (in_x & in_y & beside) | ((in_x | in_y) & in_z)


@njit(inline="always")
def _steps_over(planes, at, back):  # type: ignore[no-untyped-def]
    """Whether the way back along an axis may cross a labelled voxel that neither of its ends is in."""
    step, axis = back
    i, j, k = at[0] >> FRACTION_BITS, at[1] >> FRACTION_BITS, at[2] >> FRACTION_BITS
    bi, bj = (at[0] - step[0, axis]) >> FRACTION_BITS, (at[1] - step[1, axis]) >> FRACTION_BITS
    bk = (at[2] - step[2, axis]) >> FRACTION_BITS
    if bk == k:
        return _is_labelled(planes, bi, j, k) or _is_labelled(planes, i, bj, k)
    if _is_labelled(planes, i, j, bk) or _is_labelled(planes, bi, bj, k):
        return True
    if bi == i or bj == j:
        return False
    if _is_labelled(planes, bi, j, k) or _is_labelled(planes, i, bj, k):
        return True
    return _is_labelled(planes, bi, j, bk) or _is_labelled(planes, i, bj, bk)


@njit(inline="always")
def _is_labelled(planes, i, j, k):  # type: ignore[no-untyped-def]
    """Whether a voxel of the window is labelled; none is outside it."""
    word = (k + BELOW) >> 5
    inside = 0 <= i < planes.shape[0] and 0 <= j < planes.shape[1] and 0 <= word < planes.shape[2]
    if not inside:
        return False
    found = planes[np.uint64(i), np.uint64(j), np.uint64(word), np.uint64(OCCUPIED)]
    return (found >> np.uint32((k + BELOW) & 31)) & np.uint32(1) != 0


@njit(inline="always")
def _fill(planes, at, back, index, out):  # type: ignore[no-untyped-def]
    """Give the class stepped over on the way back between two free centres to the nearer one."""
    step, axis = back
    before = (at[0] - step[0, axis], at[1] - step[1, axis], at[2] - step[2, axis])
    kind, ratio, cell = _stepped_over(planes, before, at)
    if kind == 0:
        return
    a, b, c = index
    if ratio < 0.5:
        a, b, c = a - (axis == 0), b - (axis == 1), c - (axis == 2)
    ones, twos, _, taken = out
    bit = np.uint32(1) << np.uint32(c)
    ones[a, b] = (ones[a, b] & ~bit) | (bit if kind & 1 else np.uint32(0))
    twos[a, b] = (twos[a, b] & ~bit) | (bit if kind & 2 else np.uint32(0))
    if taken.size:
        taken[a, b, c, 0], taken[a, b, c, 1], taken[a, b, c, 2] = cell


@njit(inline="always")
def _stepped_over(planes, a, b):  # type: ignore[no-untyped-def]
    """(class, where from a = 0 to b = 1, voxel) of the first labelled voxel between two cells; class 0: none."""
    i, j, k = a[0] >> FRACTION_BITS, a[1] >> FRACTION_BITS, a[2] >> FRACTION_BITS
    ei, ej, ek = b[0] >> FRACTION_BITS, b[1] >> FRACTION_BITS, b[2] >> FRACTION_BITS
    ti = ((max(i, ei) << FRACTION_BITS) - a[0]) / (b[0] - a[0]) if ei != i else 2.0
    tj = ((max(j, ej) << FRACTION_BITS) - a[1]) / (b[1] - a[1]) if ej != j else 2.0
    tk = ((max(k, ek) << FRACTION_BITS) - a[2]) / (b[2] - a[2]) if ek != k else 2.0
    while True:
        t = min(ti, tj, tk)
        if ti == t:
            i, ti = ei, 2.0
        elif tj == t:
            j, tj = ej, 2.0
        else:
            k, tk = ek, 2.0
        if i == ei and j == ej and k == ek:
            return np.uint32(0), 0.0, (i, j, k)
        if _is_labelled(planes, i, j, k):
            return _class_at(planes, i, j, k), t, (i, j, k)


@njit(inline="always")
def _class_at(planes, i, j, k):  # type: ignore[no-untyped-def]
    """The class of a labelled voxel of the window."""
    word, bit = (k + BELOW) >> 5, np.uint32((k + BELOW) & 31)
    low, high = planes[i, j, word, LOW] >> bit, planes[i, j, word, HIGH] >> bit
    return (low & np.uint32(1)) | ((high & np.uint32(1)) << np.uint32(1))
