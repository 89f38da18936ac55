"""The grids of a frame: what numpy reads, and a word for what is damaged."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray

from services.domain.viewer.frame_grids import GridUnreadableError, read_grids
from stone.labels.grid import GRID_SHAPE
from stone_files.npz import npz_bytes


def grids(seed: int = 0) -> dict[str, NDArray[np.uint8]]:
    rng = np.random.default_rng(seed)
    return {
        key: (rng.integers(0, 4, GRID_SHAPE) * (rng.random(GRID_SHAPE) < 0.02)).astype(np.uint8)
        for key in ("semantics", "mask_lidar", "mask_camera")
    }


def test_the_grids_are_those_that_numpy_reads() -> None:
    payload = npz_bytes(grids())
    with np.load(io.BytesIO(payload)) as archive:
        for key, found in zip(
            ("mask_lidar", "semantics"), read_grids(payload, ("mask_lidar", "semantics")), strict=True
        ):
            np.testing.assert_array_equal(found, archive[key])


def test_a_stored_member_is_read_as_well() -> None:
    file, made = io.BytesIO(), grids(1)
    np.savez(file, semantics=made["semantics"])
    (found,) = read_grids(file.getvalue(), ("semantics",))
    np.testing.assert_array_equal(found, made["semantics"])


def test_what_is_damaged_or_of_another_form_is_named() -> None:
    payload = npz_bytes(grids())
    flipped = bytearray(payload)
    flipped[60:90] = bytes(30)
    small = npz_bytes({"semantics": np.zeros((2, 2, 2), np.uint8)})
    wide = npz_bytes({"semantics": np.zeros(GRID_SHAPE, np.int16)})
    for content, reason in ((bytes(flipped), "semantics"), (small, "uint8"), (wide, "int16"), (b"no zip", "zip")):
        with pytest.raises(GridUnreadableError, match=reason):
            read_grids(content, ("semantics",))
    with pytest.raises(GridUnreadableError, match="absent"):
        read_grids(payload, ("absent",))
