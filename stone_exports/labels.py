"""Labels of a frame in an export or a dataset version: its classes, and the observed voxels.

**Conventions.** As in docs/formats/labels.md: uint8 with the grid's shape, axes x y z of the ego frame. A file in the
released layout has one array, where `grid.unknown` marks unobserved voxels.
"""

import re
import zipfile
import zlib
from io import BytesIO
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_base.confidence import least_level, no_confidence
from stone_base.label_grid import PAPER, LabelGrid
from stone_exports.files import ExportContent, ExportFileSpan
from stone_exports.frames import ExportedDatum
from stone_files.dataset_layouts import LAYOUTS

MOST_LABEL_BYTES, MOST_ARRAY_BYTES = 64 * 2**20, 16 * 2**20
HEADS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
HIGHEST_CLASS, UNSURE, NOT_OBSERVED = 3, 254, 255
RELEASED_KEY = LAYOUTS["release"].label_key
# Errors of zipfile and numpy for invalid archives or arrays; `RuntimeError` for encrypted ones.
UNREADABLE = (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, OSError, RuntimeError)
Classes = NDArray[np.uint8]


def observed_classes(span: ExportFileSpan, least_confidence: float = 0.0, grid: LabelGrid = PAPER) -> Classes:
    """Return classes 0–3 with the grid's shape; `NOT_OBSERVED` if a voxel has no surface and no ray of the run passed
    it.

    An occupied voxel with a confidence below `least_confidence` is `UNSURE`. Raises `DamagedExportError`, and
    `no_confidence` if a confidence is required and the labels have none.
    """
    arrays = _arrays(span, ("confidence",) if least_confidence > 0 else (), grid)
    if RELEASED_KEY in arrays:
        classes = arrays[RELEASED_KEY]
        is_unknown = classes == (NOT_OBSERVED if grid.unknown is None else grid.unknown)
        observed = np.where(is_unknown, np.uint8(NOT_OBSERVED), classes)
        classes = np.where(is_unknown, np.uint8(0), classes)
    else:
        classes, is_observed = arrays["semantics"], arrays["mask_lidar"]
        observed = np.where((is_observed == 0) & (classes == 0), np.uint8(NOT_OBSERVED), classes)
    if classes.max() > HIGHEST_CLASS:
        raise span.damaged(f"it has class {classes.max()}; the highest class is {HIGHEST_CLASS}")
    if least_confidence > 0:
        observed[(classes != 0) & (arrays["confidence"] < least_level(least_confidence))] = UNSURE
    return observed


def _arrays(span: ExportFileSpan, further: tuple[str, ...], grid: LabelGrid) -> dict[str, Classes]:
    """Return the arrays of a labels.npz: its classes, its mask and `further` arrays.

    Sizes are checked during decompression, because the directory's sizes may be wrong.
    """
    content, keys = span.read(MOST_LABEL_BYTES), ("semantics", "mask_lidar", *further)
    try:
        with zipfile.ZipFile(BytesIO(content)) as members:
            names = members.namelist()
            if f"{RELEASED_KEY}.npy" in names:
                keys = (RELEASED_KEY, *further)
            if "confidence" in keys and "confidence.npy" not in names:
                raise no_confidence(span.name)
            return {key: _array((span, key), _member(span, members, f"{key}.npy"), grid) for key in keys}
    except UNREADABLE as error:
        raise span.damaged(f"it is not an npz with {', '.join(keys)}") from error


def _member(span: ExportFileSpan, members: zipfile.ZipFile, name: str) -> bytes:
    if members.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise span.damaged(
            f"{name} uses a compression method that npz does not use"
        )  # other methods decompress without a limit
    with members.open(name) as member:
        content = member.read(MOST_ARRAY_BYTES + 1)
    if len(content) > MOST_ARRAY_BYTES:
        raise span.damaged(f"{name} is larger than {MOST_ARRAY_BYTES} bytes")
    return content


def _array(of: tuple[ExportFileSpan, str], npy: bytes, grid: LabelGrid) -> Classes:
    """Return the grid in an npy file; its header is checked before any allocation."""
    (span, key), (shape, is_fortran, dtype, start) = of, npy_head(npy)
    if shape != grid.shape or dtype != np.uint8 or is_fortran:
        raise span.damaged(f"{key} is {dtype} {str(shape)[:80]}; expected uint8 {grid.shape}")
    return np.frombuffer(npy, np.uint8, grid.voxels, start).reshape(grid.shape)


def npy_head(npy: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, whether the order is Fortran, dtype, and the offset of the data. Raises `ValueError`,
    `KeyError`.
    """
    file = BytesIO(npy)
    try:
        shape, is_fortran, dtype = HEADS[np.lib.format.read_magic(file)](file)
    except TokenError as error:  # from an unclosed bracket, which numpy does not catch
        raise ValueError(f"its header is cut off: {error}") from error
    return shape, is_fortran, dtype, file.tell()


# Radar scans of an export: binary PCD with nuScenes' fields, as model features. A detection's velocity is the rate
# along its ray in plan, compensated for the robot's motion (`vx_comp`, `vy_comp`), in the ego frame. A 4D radar
# measures elevation, so z is measured too. Fields are found by name in any order; a scan without detections has one row
# of NaN. Source: `RadarPointCloud.from_file` of nuscenes-devkit 1.2; 4D radar fields: docs/formats/exports.md.


MOST_SCAN_BYTES, MOST_HEAD_BYTES = 16 * 2**20, 4096
KINDS = {
    ("F", 4): "<f4",
    ("F", 8): "<f8",
    ("I", 1): "i1",
    ("I", 2): "<i2",
    ("I", 4): "<i4",
    ("U", 1): "u1",
    ("U", 2): "<u2",
}
WANTED = ("x", "y", "z", "rcs", "vx_comp", "vy_comp")
FARTHEST_DETECTION_M = 1e4


def detections_ego(datum: ExportedDatum) -> NDArray[np.float32]:
    """Return rows (N, 6): x y z in metres, RCS in dBsm, v_x v_y over ground in m/s, in the ego frame at measurement.

    Raises `DamagedExportError`.
    """
    records = scan_records(datum.span)
    rows = np.stack([records[name].astype(np.float64) for name in WANTED], axis=1)
    rows = rows[(np.abs(rows) < FARTHEST_DETECTION_M).all(axis=1)]
    ego_from_radar = datum.sensor.ego_from_sensor
    velocities = np.pad(rows[:, 4:], ((0, 0), (0, 1))) @ ego_from_radar.rotation().T
    return np.concatenate([ego_from_radar @ rows[:, :3], rows[:, 3:4], velocities[:, :2]], axis=1).astype(np.float32)


def scan_records(span: ExportContent) -> NDArray[np.void]:
    """Return the records of a binary PCD that has the fields of detections. Raises `DamagedExportError`."""
    content = span.read(MOST_SCAN_BYTES)
    head, mark, body = content[:MOST_HEAD_BYTES].partition(b"DATA binary\n")
    if not mark:
        raise span.damaged("it is not a binary PCD")
    header = dict(re.findall(r"^([A-Z]+) (.*)$", head.decode("ascii", "replace"), re.MULTILINE))
    try:
        points, counts = int(header["POINTS"]), set(header.get("COUNT", "1").split())
        parts = zip(header["FIELDS"].split(), header["TYPE"].split(), header["SIZE"].split(), strict=True)
        record = np.dtype([(name, KINDS[kind, int(size)]) for name, kind, size in parts])
    except (KeyError, ValueError) as error:
        raise span.damaged("its PCD header is invalid") from error
    body = content[len(head) + len(mark) :]
    if counts != {"1"}:
        raise span.damaged("one of its fields has several values")
    if missing := [name for name in WANTED if name not in (record.names or ())]:
        raise span.damaged(f"it has no field {missing[0]!r}")
    if not 0 <= points <= len(body) // record.itemsize:
        raise span.damaged(
            f"its header declares {points} detections, but it has bytes for {len(body) // record.itemsize}"
        )
    return np.frombuffer(body, record, points)
