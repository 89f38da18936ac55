"""Reads single grids of a frame's `labels.npz` for the pages, as strictly as those of a submission."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from services.runtime.store.protocol import Store
from stone.errors import PlatformFaultError
from stone_submissions.errors import SubmissionError
from stone_submissions.npz_frame import npz_members, read_grid

SHOWN_GRIDS = ("semantics", "mask_lidar")


def grid_unreadable(key: str, reason: str) -> PlatformFaultError:
    return PlatformFaultError(
        "grid_unreadable", f"grid {key!r} of a frame cannot be read: {reason}; was the store changed by hand?"
    )


def stored_grids(store: Store, object_key: str, span: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Classes and what was seen, of the label file in these bytes of an object. Raises `grid_unreadable`."""
    semantics, seen = read_grids(b"".join(store.read(object_key, *span)), SHOWN_GRIDS)
    return semantics, seen


def read_grids(payload: bytes, keys: Iterable[str]) -> list[NDArray[np.uint8]]:
    """The grids (256, 256, 32) of these keys, in their order. Raises `grid_unreadable`."""
    grids, key = list[NDArray[np.uint8]](), ""
    try:
        members = npz_members(payload)
        for key in keys:
            grids.append(read_grid(payload, members[key]))
    except KeyError as error:
        raise grid_unreadable(key, "it is not in the file") from error
    except SubmissionError as error:
        raise grid_unreadable(key, f"expected {error.expected}, found {error.actual}") from error
    return grids
