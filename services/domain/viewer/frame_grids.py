"""Reads single grids of a frame's `labels.npz` for the pages, as strictly as grids of a submission."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from services.runtime.store.protocol import Store
from stone.errors import PlatformFaultError, Refused
from stone_base.label_grid import LabelGrid, grid_with_shape
from stone_submissions.errors import SubmissionError
from stone_submissions.npz_frame import array_shape, npz_members, read_grid

SHOWN_GRIDS = ("semantics", "mask_lidar")


def grid_unreadable(key: str, reason: str) -> PlatformFaultError:
    return PlatformFaultError(
        "grid_unreadable", f"grid {key!r} of a frame cannot be read: {reason}; was the store changed by hand?"
    )


def stored_grids(store: Store, object_key: str, span: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return classes and observed mask of the label file in this byte range of an object. Raises `grid_unreadable`."""
    semantics, seen = read_grids(b"".join(store.read(object_key, *span)), SHOWN_GRIDS)
    return semantics, seen


def _grid_of(shape: tuple[int, ...]) -> LabelGrid:
    """Return a grid with this shape. Raises `bad_shape`."""
    try:
        return grid_with_shape(shape)
    except Refused as error:
        raise SubmissionError("bad_shape", "the shape of a label grid", str(shape)) from error


def read_grids(payload: bytes, keys: Iterable[str]) -> list[NDArray[np.uint8]]:
    """Return the grids of these keys, in order; all have the shape of the first, which must be a label grid's.

    Raises `grid_unreadable`.
    """
    grids, key, known = list[NDArray[np.uint8]](), "", None
    try:
        members = npz_members(payload)
        for key in keys:
            known = known or _grid_of(array_shape(payload, members[key]))
            grids.append(read_grid(payload, members[key], known))
    except KeyError as error:
        raise grid_unreadable(key, "it is not in the file") from error
    except SubmissionError as error:
        raise grid_unreadable(key, f"expected {error.expected}, found {error.actual}") from error
    return grids
