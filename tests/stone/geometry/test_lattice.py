"""Keys against plain integer arithmetic, the table against a dict; the box around points."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stone.geometry.corners import corners_of
from stone.geometry.lattice import BIAS, centres_of, find, indices_of, keys_from_indices, keys_of, table_of
from testing.refusals import refused_as

EDGE = BIAS - 3
indices = st.lists(st.tuples(*[st.integers(-EDGE, EDGE)] * 3), min_size=1, max_size=50)


@settings(deadline=None)
@given(indices)
def test_a_key_gives_its_indices_back_in_x_y_z_order_and_the_centre_lies_in_its_voxel(rows):
    keys = keys_from_indices(np.array(rows, np.int64))
    assert indices_of(keys).tolist() == [list(row) for row in rows]
    assert [tuple(row) for row in indices_of(np.sort(keys)).tolist()] == sorted(rows)
    assert (keys_of(centres_of(keys, 0.2), 0.2) == keys).all()
    assert len(keys_of(np.zeros((0, 3)), 0.2)) == 0


def test_a_point_lies_in_the_voxel_of_its_floor():
    points = np.random.default_rng(1).uniform(-500, 500, (2000, 3))
    expected = [[math.floor(c / 0.25) for c in point] for point in points]
    assert indices_of(keys_of(points, 0.25)).tolist() == expected


def test_voxels_are_half_open():
    points = np.array([[0.0, 0.25, -0.25], [0.2499, -1e-9, 0.5]])
    assert indices_of(keys_of(points, 0.25)).tolist() == [[0, 1, -1], [0, -1, 2]]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 3000))
def test_the_table_finds_what_a_dict_finds(seed, count):
    rng = np.random.default_rng(seed)
    keys = np.unique(keys_from_indices(rng.integers(-12, 12, (count, 3))))
    rng.shuffle(keys)
    table, rows = table_of(keys), {int(key): row for row, key in enumerate(keys)}
    for key in keys_from_indices(rng.integers(-14, 14, (200, 3))):
        assert find.py_func(table.keys, table.rows, key) == rows.get(int(key), -1)


def test_a_table_is_at_most_half_full():
    for count in (0, 1, 15, 16, 17, 1000, 1024, 1025):
        slots = len(table_of(np.arange(count, dtype=np.int64)).keys)
        assert count <= slots / 2
        assert slots & (slots - 1) == 0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 4_500_000.0])
def test_coordinates_off_the_lattice_are_refused(bad):
    with refused_as("off_lattice"):
        keys_of(np.array([[0.0, bad, 0.0]]), 0.2)


@given(arrays(np.float64, st.tuples(st.integers(1, 9), st.integers(1, 4)), elements=st.floats(-1e6, 1e6)))
def test_all_points_lie_in_the_box_and_each_of_its_sides_holds_one(points):
    low, high = corners_of(points)
    assert ((low <= points) & (points <= high)).all()
    assert (points == low).any(axis=0).all()
    assert (points == high).any(axis=0).all()


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.float32])
def test_corners_are_numbers_of_the_points_kind(kind):
    low, high = corners_of(np.array([[1, 5], [3, 2]], kind))
    assert (low.dtype, high.dtype) == (kind, kind)
    assert (low.tolist(), high.tolist()) == ([1, 2], [3, 5])


def test_no_number_along_an_axis_leaves_none_there():
    low, high = corners_of(np.array([[1.0, np.nan], [2.0, 0.0]]))
    assert (low[0], high[0]) == (1.0, 2.0)
    assert np.isnan([low[1], high[1]]).all()
