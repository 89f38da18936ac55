"""Lanes of rays: places in a window have shares for each axis, and no more is written than there is room for."""

import numpy as np
import pytest
from numba import njit

from stone.labels.ray_lanes import AXIS_BITS, CELLS, END, LANES, TIMES, axis_mask, follow, share_of, step_of


@njit
def followed(times, cells, bits, places):
    masks = axis_mask(bits, 0), axis_mask(bits, 1), axis_mask(bits, 2)
    return follow(times, cells, 0, masks, places)


@pytest.mark.parametrize("bits", [1, 5, 8])
def test_axes_share_out_all_bits_of_a_place(bits):
    masks = [axis_mask(bits, axis) for axis in range(3)]
    assert sum(masks) == masks[0] | masks[1] | masks[2] == 2 ** (3 * bits + 6) - 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_step_leads_to_the_next_share_and_around_the_window(axis):
    bits, voxels = 3, 4 * 2**3
    mask = axis_mask(bits, axis)
    for index in range(voxels):
        share = share_of(index, bits, axis)
        assert (share + step_of(1.0, bits, axis)) & mask == share_of((index + 1) % voxels, bits, axis)
        assert (share + step_of(-1.0, bits, axis)) & mask == share_of((index - 1) % voxels, bits, axis)


@pytest.mark.parametrize("steps", [1, 3, 40])
def test_no_more_is_written_than_there_is_room_for(steps):
    times, cells = np.zeros((TIMES, LANES), np.int64), np.zeros((CELLS, LANES), np.int32)
    times[:3] = np.arange(3)[:, None]  # one crossing after another, along x first
    times[3:6] = 3 << AXIS_BITS
    times[END], cells[3:] = np.iinfo(np.int64).max, 1
    places = np.full((steps + 1) * LANES - 1, -1, np.int32)
    assert followed(times, cells, 2, places) == steps * LANES
    assert (places[: steps * LANES] >= 0).all()
    assert (places[steps * LANES :] == -1).all()
