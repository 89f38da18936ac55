"""What a part leaves of a tile comes back bit for bit, small and the same however often it is written."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.map.fused_files import fused_columns, fused_observed, fused_points
from stone.geometry.lattice import indices_of, keys_from_indices
from stone.labels.observed_voxels import Observed
from stone.surface.pointmap import PointMap

NOTHING_SEEN = Observed(np.zeros(0, np.int64), np.zeros(0, np.uint64))


def map_of(seed, count, reach, largest):
    rng = np.random.default_rng(seed)
    keys = np.unique(keys_from_indices(rng.integers(-reach, reach + 1, (count, 3))))
    moments = rng.integers(-largest, largest, (len(keys), 8), dtype=np.int64)
    moments[:, :2] = np.abs(moments[:, :2]) + 1
    return PointMap(0.1, keys, moments)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 60), st.sampled_from([0, 3, 500, 2**20 - 2]), st.integers(1, 2**62))
def test_a_point_map_comes_back_bit_for_bit(seed, count, reach, largest):
    points = map_of(seed, count, reach, largest)
    read = fused_points(fused_columns(points, NOTHING_SEEN), 0.1)
    assert read.keys.tobytes() == points.keys.tobytes()
    assert read.moments.tobytes() == points.moments.tobytes()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 200), st.sampled_from([3, 9, 2**20 - 2]), st.data())
def test_a_rectangle_of_a_point_map_is_its_voxels_there(seed, count, reach, data):
    points, index = map_of(seed, count, reach, 1000), st.integers(-reach - 2, reach + 2)
    low, high = np.sort([data.draw(st.tuples(index, index)) for _ in range(2)], axis=0)
    read = fused_points(fused_columns(points, NOTHING_SEEN), 0.1, (low, high))
    places = indices_of(points.keys)[:, :2]
    inside = points.where(((low <= places) & (places < high)).all(axis=1))
    assert read.keys.tobytes() == inside.keys.tobytes()
    assert read.moments.tobytes() == inside.moments.tobytes()


@given(st.sets(st.integers(0, 2**62), max_size=40))
def test_what_was_observed_comes_back_bit_for_bit(keys):
    observed = Observed(np.array(sorted(keys), np.int64), np.arange(len(keys), dtype=np.uint64) << np.uint64(57))
    read = fused_observed(fused_columns(map_of(1, 0, 1, 1), observed))
    assert read.keys.tobytes() == observed.keys.tobytes()
    assert read.words.tobytes() == observed.words.tobytes()


@pytest.mark.parametrize(("largest", "width"), [(100, 1), (30_000, 2), (2**30, 4), (2**40, 8)])
def test_sums_take_no_more_bytes_than_they_need(largest, width):
    columns = fused_columns(map_of(2, 500, 200, largest), NOTHING_SEEN)
    assert columns["offsets"].dtype == columns["views"].dtype == np.dtype(f"i{width}")


def test_a_voxel_of_a_run_takes_less_than_half_of_what_it_is_in_memory():
    points = map_of(3, 5000, 240, 2**24)
    points.moments[:, :2] %= (2000, 60)
    stored = fused_columns(points, NOTHING_SEEN)
    assert sum(column.nbytes for column in stored.values()) < (points.keys.nbytes + points.moments.nbytes) / 2
