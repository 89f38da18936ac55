"""Labels of a frame in an export or in a version of the dataset: its classes, and which voxels were observed.

**Conventions.** As docs/formats/labels.md: uint8 (256, 256, 32), axes x y z of the ego frame.
"""

import zipfile
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from stone.labels.grid import GRID_SHAPE
from stone_exports.files import ExportFileSpan

MOST_LABEL_BYTES, MOST_ARRAY_BYTES = 64 * 2**20, 16 * 2**20
HIGHEST_CLASS, NOT_OBSERVED = 3, 255
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
    """Arrays of a labels.npz, bounded before they are inflated."""
    content = span.read(MOST_LABEL_BYTES)
    try:
        with zipfile.ZipFile(BytesIO(content)) as members:
            sizes = {member.filename: member.file_size for member in members.infolist()}
            if any(sizes.get(f"{key}.npy", 0) > MOST_ARRAY_BYTES for key in keys):
                raise span.damaged(f"an array is larger than {MOST_ARRAY_BYTES} bytes")
            found = {
                key: np.lib.format.read_array(BytesIO(members.read(f"{key}.npy")), allow_pickle=False) for key in keys
            }
    except (zipfile.BadZipFile, KeyError, ValueError, EOFError, OSError, NotImplementedError) as error:
        raise span.damaged(f"it is no npz of {', '.join(keys)}") from error
    for key, array in found.items():
        if array.shape != GRID_SHAPE or array.dtype != np.uint8:
            raise span.damaged(f"{key} is {array.dtype} {array.shape}, expected is uint8 {GRID_SHAPE}")
    return found
