"""What is written stored is read back by mapping it, and by numpy."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone_files.mapped_npz import ALIGNED_BYTES, mapped_npz, write_stored_npz
from stone_files.npz import UnwritableArrayError

DTYPES = [np.dtype(name) for name in ("u1", "i8", "f4", "?", ">i4", "u8", "f8")]
ARRAYS: st.SearchStrategy[NDArray[Any]] = st.sampled_from(DTYPES).flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=0, min_side=0, max_dims=3))
)


def written(folder: Path, arrays: dict[str, NDArray[Any]]) -> Path:
    with (folder / "arrays.npz").open("wb") as file:
        write_stored_npz(file, arrays)
    return folder / "arrays.npz"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.text("abc", min_size=1, max_size=70), ARRAYS, max_size=4))
def test_what_is_mapped_and_what_numpy_reads_is_what_was_written(
    tmp_path: Path, arrays: dict[str, NDArray[Any]]
) -> None:
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
    with pytest.raises(UnwritableArrayError, match="dtype object"):
        written(tmp_path, {"a": np.array([{}], object)})
