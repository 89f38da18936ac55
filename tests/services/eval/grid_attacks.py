"""Hostile submissions of two frames at any grid, each with the code it must be refused with.

**Conventions.** A case makes the bytes of a submission; its second frame is honest. What depends on the grid's size is
made of it: arrays of other shapes, the least size that is too large, the place where a bomb goes on.
"""

import io
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from stone_base.label_grid import PAPER, RELEASE, LabelGrid
from stone_submissions.archive import frame_file

TOKENS = ("0" * 31 + "1", "0" * 31 + "2")
OWN = LabelGrid("own", (0.0, -12.8, -1.6), 0.4, (64, 64, 16))
BOMB_BYTES = 64 * 2**20


@dataclass(frozen=True)
class GridAttack:
    """A code, words of its problem's expectation or finding, and the submission at a grid."""

    code: str
    words: Callable[[LabelGrid], str]
    made: Callable[[LabelGrid], bytes]


def saved(**arrays: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def blank(grid: LabelGrid) -> NDArray[np.uint8]:
    return np.zeros(grid.shape, np.uint8)


def spoiled(grid: LabelGrid, value: int) -> NDArray[np.uint8]:
    """A frame whose last voxel has the value."""
    frame = blank(grid)
    frame[-1, -1, -1] = value
    return frame


def other_than(grid: LabelGrid) -> LabelGrid:
    """A known grid of another shape."""
    return RELEASE if grid.shape == PAPER.shape else PAPER


def submission(grid: LabelGrid, first: bytes, *more: tuple[str, bytes]) -> bytes:
    file = io.BytesIO()
    with ZipFile(file, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a name that is written twice
        for name, content in ((f"{TOKENS[0]}.npz", first), (f"{TOKENS[1]}.npz", frame_file(blank(grid), grid)), *more):
            archive.writestr(ZipInfo(name), content)
    return file.getvalue()


def honest(grid: LabelGrid) -> bytes:
    return frame_file(blank(grid), grid)


def frames(code: str, words: Callable[[LabelGrid], str], first: Callable[[LabelGrid], bytes]) -> GridAttack:
    return GridAttack(code, words, lambda grid: submission(grid, first(grid)))


def of_values(value: int) -> GridAttack:
    return frames("label_out_of_range", lambda _: str(value), lambda grid: saved(semantics=spoiled(grid, value)))


def of_arrays(code: str, change: Callable[[NDArray[np.uint8]], NDArray[Any]]) -> GridAttack:
    def words(grid: LabelGrid) -> str:
        made = change(blank(grid))
        if not made.flags.c_contiguous:
            return "C order"
        return str(made.shape) if code == "bad_shape" else repr(made.dtype.str)

    return frames(code, words, lambda grid: saved(semantics=change(blank(grid))))


def bomb(grid: LabelGrid) -> bytes:
    """A npy that its directory says is of the grid's size, and goes on for `BOMB_BYTES`."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": grid.shape})
    file = io.BytesIO()
    with ZipFile(file, "w", ZIP_DEFLATED) as archive:
        archive.writestr("semantics.npy", head.getvalue() + bytes(BOMB_BYTES))
    size = len(head.getvalue())
    true, declared = ((size + more).to_bytes(4, "little") for more in (BOMB_BYTES, grid.voxels))
    return file.getvalue().replace(true, declared)


def linked(grid: LabelGrid) -> bytes:
    """A first frame that is a symbolic link."""
    file = io.BytesIO()
    with ZipFile(file, "w") as archive:
        link = ZipInfo(f"{TOKENS[0]}.npz")
        link.create_system, link.external_attr = 3, 0o120777 << 16
        archive.writestr(link, "/etc/passwd")
        archive.writestr(f"{TOKENS[1]}.npz", honest(grid))
    return file.getvalue()


GRID_ATTACKS: Mapping[str, GridAttack] = {
    "another grid": frames(
        "bad_shape", lambda grid: str(other_than(grid).shape), lambda grid: honest(other_than(grid))
    ),
    "z first": of_arrays("bad_shape", lambda frame: np.ascontiguousarray(frame.transpose(2, 0, 1))),
    "scores": of_arrays("bad_shape", lambda frame: np.stack([frame] * 4)),
    "a voxel less": of_arrays("bad_shape", lambda frame: np.ascontiguousarray(frame[:, :, :-1])),
    "flat": of_arrays("bad_shape", lambda frame: frame.reshape(1, -1)),
    "Fortran order": of_arrays("bad_shape", np.asfortranarray),
    "int64": of_arrays("bad_dtype", lambda frame: frame.astype(np.int64)),
    "floats": of_arrays("bad_dtype", lambda frame: frame.astype(np.float32)),
    "4 in a prediction": of_values(4),
    "17 in a prediction": of_values(17),
    "255 in a prediction": of_values(255),
    "the release's own key": frames("missing_array", lambda _: "label", lambda grid: saved(label=blank(grid))),
    "two arrays": frames(
        "extra_array", lambda _: "one array", lambda grid: saved(semantics=blank(grid), observed=blank(grid))
    ),
    "a bomb of the grid's size": frames("too_large", lambda _: "continues", bomb),
    "a byte more than a frame may have": frames(
        "too_large", lambda grid: str(grid.voxels + 2**20), lambda grid: bytes(grid.voxels + 2**20 + 1)
    ),
    "cut": frames("truncated", lambda _: "", lambda grid: saved(semantics=blank(grid))[:200]),
    "a frame twice": GridAttack(
        "duplicate_frame",
        lambda _: "second",
        lambda grid: submission(grid, honest(grid), (f"{TOKENS[0]}.npz", honest(grid))),
    ),
    "a name outside": GridAttack(
        "unexpected_file",
        lambda _: "another file",
        lambda grid: submission(grid, honest(grid), (f"../{TOKENS[0]}.npz", b"")),
    ),
    "a link": GridAttack("symlink", lambda _: "", linked),
}
