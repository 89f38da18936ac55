"""Keys against plain integer arithmetic, the table against a dict."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import (
    BIAS,
    OffLatticeError,
    centres_of,
    find,
    indices_of,
    keys_from_indices,
    keys_of,
    table_of,
)

EDGE = BIAS - 3
indices = st.lists(st.tuples(*[st.integers(-EDGE, EDGE)] * 3), min_size=1, max_size=50)


@settings(deadline=None)
@given(indices)
def test_a_key_gives_its_indices_back(rows):
    assert indices_of(keys_from_indices(np.array(rows, np.int64))).tolist() == [list(row) for row in rows]


@settings(deadline=None)
@given(indices)
def test_sorted_keys_are_in_x_y_z_order(rows):
    keys = np.sort(keys_from_indices(np.array(rows, np.int64)))
    assert [tuple(row) for row in indices_of(keys).tolist()] == sorted(rows)


@settings(deadline=None)
@given(indices)
def test_the_centre_of_a_voxel_lies_in_it(rows):
    keys = keys_from_indices(np.array(rows, np.int64))
    assert (keys_of(centres_of(keys, 0.2), 0.2) == keys).all()


def test_a_point_lies_in_the_voxel_of_its_floor():
    points = np.random.default_rng(1).uniform(-500, 500, (2000, 3))
    expected = [[math.floor(c / 0.25) for c in point] for point in points]
    assert indices_of(keys_of(points, 0.25)).tolist() == expected


def test_voxels_are_half_open():
    points = np.array([[0.0, 0.25, -0.25], [0.2499, -1e-9, 0.5]])
    assert indices_of(keys_of(points, 0.25)).tolist() == [[0, 1, -1], [0, -1, 2]]


def test_no_points_have_no_keys():
    assert len(keys_of(np.zeros((0, 3)), 0.2)) == 0


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
    with pytest.raises(OffLatticeError, match=r"the lattice ends at 209715 m: is a pose broken"):
        keys_of(np.array([[0.0, bad, 0.0]]), 0.2)
