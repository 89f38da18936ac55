"""What `npz_bytes` writes, numpy reads back; the same arrays give the same bytes."""

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone_files.npz import ALIGNED_BYTES, mapped_npz, npz_bytes, write_stored_npz
from testing.refusals import refused_as

DTYPES = [np.dtype(name) for name in ("u1", "i8", "f4", "?", ">i4", "u8", "f8")]
ARRAYS: st.SearchStrategy[NDArray[Any]] = st.sampled_from(DTYPES).flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=0, min_side=0, max_dims=3))
)


@given(st.dictionaries(st.sampled_from("abcd"), ARRAYS))
def test_numpy_reads_back_what_was_written(arrays: dict[str, NDArray[Any]]) -> None:
    with np.load(io.BytesIO(npz_bytes(arrays)), allow_pickle=False) as stored:
        assert list(stored) == list(arrays)
        for key, array in arrays.items():
            assert stored[key].dtype == array.dtype
            np.testing.assert_array_equal(stored[key], array)


@pytest.mark.parametrize("level", [0, 1, 3])
def test_grids_survive_at_every_level(level: int) -> None:
    grid = np.random.default_rng(0).integers(0, 4, (64, 64, 32), dtype=np.uint8)
    archive = npz_bytes({"noise": grid, "free": grid * 0}, level)
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        assert opened.testzip() is None
    with np.load(io.BytesIO(archive)) as stored:
        np.testing.assert_array_equal(stored["noise"], grid)
        assert not stored["free"].any()


def test_the_same_arrays_give_the_same_bytes_and_objects_are_refused() -> None:
    grid = np.random.default_rng(0).integers(0, 4, (16, 16, 8), dtype=np.uint8)
    assert npz_bytes({"semantics": grid}) == npz_bytes({"semantics": grid.copy()})
    with refused_as("unwritable_array"):
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


def written(folder: Path, arrays: dict[str, NDArray[Any]]) -> Path:
    with (folder / "arrays.npz").open("wb") as file:
        write_stored_npz(file, arrays)
    return folder / "arrays.npz"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.text("abc", min_size=1, max_size=70), ARRAYS, max_size=4))
def test_what_is_mapped_and_what_numpy_reads_is_what_was_written(tmp_path, arrays):
    path = written(tmp_path, arrays)
    mapped = mapped_npz(path)
    with np.load(path, allow_pickle=False) as loaded:
        assert list(mapped) == list(arrays) == list(loaded)
        for key, array in arrays.items():
            for read in (mapped[key], loaded[key]):
                assert (read.dtype, read.shape) == (array.dtype, array.shape)
                assert read.tobytes() == array.tobytes()


def test_numbers_are_aligned_and_checksums_right(tmp_path: Path) -> None:
    path = written(tmp_path, {"a": np.arange(3, dtype=np.uint8), "longer_name": np.arange(5.0), "z": np.zeros(7)})
    assert all(array.ctypes.data % ALIGNED_BYTES == 0 and array.flags.aligned for array in mapped_npz(path).values())
    with zipfile.ZipFile(path) as opened:
        assert opened.testzip() is None


def test_writing_to_what_was_mapped_changes_no_file_and_deleting_the_file_no_array(tmp_path: Path) -> None:
    path = written(tmp_path, {"a": np.arange(4)})
    first, second = mapped_npz(path)["a"], mapped_npz(path)["a"]
    path.unlink()
    first[0] = 9
    assert (first.tolist(), second.tolist()) == ([9, 1, 2, 3], [0, 1, 2, 3])


def test_an_array_of_objects_is_refused(tmp_path: Path) -> None:
    with refused_as("unwritable_array"):
        written(tmp_path, {"a": np.array([{}], object)})
