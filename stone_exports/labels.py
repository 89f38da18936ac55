"""Labels of a frame in an export or in a version of the dataset: its classes, and which voxels were observed.

**Conventions.** As docs/formats/labels.md: uint8 (256, 256, 32), axes x y z of the ego frame.
"""

import zipfile
import zlib
from io import BytesIO
from math import prod

import numpy as np
from numpy.typing import NDArray

from stone.labels.grid import GRID_SHAPE
from stone_exports.files import ExportFileSpan

MOST_LABEL_BYTES, MOST_ARRAY_BYTES = 64 * 2**20, 16 * 2**20
HIGHEST_CLASS, NOT_OBSERVED = 3, 255
# What zipfile and numpy raise for bytes that are no archive or no array; `RuntimeError` for one that is encrypted.
UNREADABLE = (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, OSError, RuntimeError)
Classes = NDArray[np.uint8]


def observed_classes(span: ExportFileSpan) -> Classes:
    """Classes 0–3 (256, 256, 32), `NOT_OBSERVED` where neither a surface is nor a ray of the run passed.

    Raises `DamagedExportError`.
    """
    arrays = _arrays(span, ("semantics", "mask_lidar"))
    classes, is_observed = arrays["semantics"], arrays["mask_lidar"]
    if classes.max() > HIGHEST_CLASS:
        raise span.damaged(f"it has class {classes.max()}, the highest is {HIGHEST_CLASS}")
    return np.where((is_observed == 0) & (classes == 0), np.uint8(NOT_OBSERVED), classes)


def _arrays(span: ExportFileSpan, keys: tuple[str, ...]) -> dict[str, Classes]:
    """Arrays of a labels.npz, bounded while they are inflated: what its directory says of sizes may be a lie."""
    content = span.read(MOST_LABEL_BYTES)
    try:
        with zipfile.ZipFile(BytesIO(content)) as members:
            return {key: _array(span, key, _member(span, members, f"{key}.npy")) for key in keys}
    except UNREADABLE as error:
        raise span.damaged(f"it is not an npz of {', '.join(keys)}") from error


def _member(span: ExportFileSpan, members: zipfile.ZipFile, name: str) -> bytes:
    if members.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise span.damaged(f"{name} is compressed by a method that npz does not use")  # and such unpacking has no bound
    with members.open(name) as member:
        content = member.read(MOST_ARRAY_BYTES + 1)
    if len(content) > MOST_ARRAY_BYTES:
        raise span.damaged(f"{name} is larger than {MOST_ARRAY_BYTES} bytes")
    return content


def _array(span: ExportFileSpan, key: str, npy: bytes) -> Classes:
    """The grid that a npy file holds; what its header says is compared before anything of that size is made."""
    file = BytesIO(npy)
    reads = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, is_fortran, dtype = reads[np.lib.format.read_magic(file)](file)
    if shape != GRID_SHAPE or dtype != np.uint8 or is_fortran:
        raise span.damaged(f"{key} is {dtype} {str(shape)[:80]}, expected is uint8 {GRID_SHAPE}")
    return np.frombuffer(npy, np.uint8, prod(GRID_SHAPE), file.tell()).reshape(GRID_SHAPE)
