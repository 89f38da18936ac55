"""Writes submissions: a zip of `<frame_token>.npz`, one uint8 grid each."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone_base.label_grid import GRID_SHAPE
from stone_files.atomic import atomic_file
from stone_files.npz import npz_bytes
from stone_submissions.errors import BadDtypeError, BadShapeError

Grid = NDArray[np.uint8]


def write_files(path: Path, frames: Iterable[tuple[str, bytes]]) -> None:
    """Frames (token, `frame_file`) as a submission. They are stored, not deflated again: they are deflated inside."""
    with atomic_file(path) as staging, zipfile.ZipFile(staging, "w") as archive:
        for token, content in frames:
            archive.writestr(zipfile.ZipInfo(f"{token}.npz"), content)


def frame_file(grid: Grid) -> bytes:
    """The file of one frame. Raises `BadDtypeError`, `BadShapeError`."""
    if grid.dtype != np.uint8:
        raise BadDtypeError("uint8 ('|u1')", str(grid.dtype))
    if grid.shape != GRID_SHAPE:
        raise BadShapeError(str(GRID_SHAPE), str(grid.shape))
    return npz_bytes({"semantics": grid})
