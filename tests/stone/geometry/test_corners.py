"""The box around points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stone.geometry.corners import corners_of


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
