"""What `npz_bytes` writes, numpy reads back; the same arrays give the same bytes."""

import io
import zipfile
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone_files.npz import UnwritableArrayError, npz_bytes

DTYPES = [np.dtype(name) for name in ("u1", "i8", "f4", "?", ">i4")]
ARRAYS: st.SearchStrategy[NDArray[Any]] = st.sampled_from(DTYPES).flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(max_dims=3))
)


@given(st.dictionaries(st.sampled_from("abcd"), ARRAYS))
def test_numpy_reads_back_what_was_written(arrays: dict[str, NDArray[Any]]) -> None:
    with np.load(io.BytesIO(npz_bytes(arrays)), allow_pickle=False) as stored:
        assert list(stored) == list(arrays)
        for key, array in arrays.items():
            assert stored[key].dtype == array.dtype
            np.testing.assert_array_equal(stored[key], array)


def test_empty_and_zero_dimensional_arrays_survive() -> None:
    arrays: dict[str, NDArray[Any]] = {"empty": np.zeros((0, 3), np.float32), "scalar": np.array(7, np.int64)}
    with np.load(io.BytesIO(npz_bytes(arrays))) as stored:
        assert stored["empty"].shape == (0, 3)
        assert stored["scalar"] == 7
        assert stored["scalar"].shape == ()


def test_a_fortran_array_is_written_in_c_order() -> None:
    array = np.asfortranarray(np.arange(24, dtype=np.uint8).reshape(2, 3, 4))
    with np.load(io.BytesIO(npz_bytes({"a": array}))) as stored:
        assert stored["a"].flags.c_contiguous
        np.testing.assert_array_equal(stored["a"], array)


def test_every_member_passes_the_checks_of_zipfile() -> None:
    archive = npz_bytes({"semantics": np.zeros((8, 8), np.uint8), "mask_lidar": np.ones((8, 8), np.uint8)})
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        assert opened.testzip() is None
        assert opened.namelist() == ["semantics.npy", "mask_lidar.npy"]


@pytest.mark.parametrize("level", [0, 1, 3])
def test_grids_survive_at_every_level(level: int) -> None:
    grid = np.random.default_rng(0).integers(0, 4, (64, 64, 32), dtype=np.uint8)
    archive = npz_bytes({"noise": grid, "free": grid * 0}, level)
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        assert opened.testzip() is None
    with np.load(io.BytesIO(archive)) as stored:
        np.testing.assert_array_equal(stored["noise"], grid)
        assert not stored["free"].any()


def test_the_same_arrays_give_the_same_bytes() -> None:
    grid = np.random.default_rng(0).integers(0, 4, (16, 16, 8), dtype=np.uint8)
    assert npz_bytes({"semantics": grid}) == npz_bytes({"semantics": grid.copy()})


def test_an_object_array_is_refused() -> None:
    with pytest.raises(UnwritableArrayError, match="'a' of dtype object"):
        npz_bytes({"a": np.array([{}, 1], dtype=object)})


def test_data_that_was_deflated_elsewhere_are_taken_as_they_are() -> None:
    """Behind the npy header, which is stored: the checksum is of both."""
    grid = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    stream = zlib.compressobj(wbits=-15)
    block = stream.compress(grid.tobytes()) + stream.flush()
    payload = npz_bytes({"grid": grid, "other": grid + 1}, deflated={"grid": block})
    assert block in payload
    with np.load(io.BytesIO(payload), allow_pickle=False) as found:
        assert found.files == ["grid", "other"]
        np.testing.assert_array_equal(found["grid"], grid)
        np.testing.assert_array_equal(found["other"], grid + 1)
