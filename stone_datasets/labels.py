"""Labels of a frame in a published dataset: the platform's classes, and masks if the file has them.

**Conventions.** As in docs/formats/labels.md: uint8 with the shape of the layout's grid, axes x y z of the ego frame.
An array is inflated only up to the size in its header, which is checked first.
"""

import struct
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from stone_base.label_grid import LabelGrid
from stone_datasets.classes import OWN_CLASSES, UNKNOWN, UNOBSERVED, ClassMap
from stone_datasets.faults import DatasetPlace
from stone_exports.files import DamagedExportError, ExportFileSpan
from stone_exports.labels import UNREADABLE, npy_head
from stone_files.dataset_faults import DatasetFaultError
from stone_files.dataset_layouts import LAYOUTS, DatasetLayout, recognised_layout

MOST_PACKED_BYTES = 32 * 2**20
MOST_ARRAYS = 64
HEAD_BYTES, LOCAL_BYTES = 128, 30
RAW = -15
INFLATING: type[Exception] = isal_zlib.error  # type: ignore[assignment]
NO_NPY = (INFLATING, ValueError, KeyError, EOFError, OSError, TypeError, SyntaxError)
known_head = lru_cache(maxsize=256)(npy_head)  # all files of a dataset have the same header
SEMANTICS, MASK_LIDAR, MASK_CAMERA = "semantics", "mask_lidar", "mask_camera"
PLAIN = tuple(f"{key}.npy" for key in (SEMANTICS, MASK_LIDAR, MASK_CAMERA))
FURTHER = {"late.npy": np.uint8, "distance_squared.npy": np.float16, "confidence.npy": np.uint8}
Grid = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class FrameLabels:
    """`classes` 0–3; `mask_lidar` is 1 for observed voxels, `mask_camera` for voxels a camera sees; None if unknown.

    Unobserved voxels are free in `classes` and 0 in `mask_lidar`. `content` is the file if the platform's reader gives
    the same labels: the file has the three grids with the platform's classes, and no arrays beyond the platform's
    optional ones.
    """

    classes: Grid
    mask_lidar: Grid | None
    mask_camera: Grid | None
    content: bytes | None = None


def read_labels(
    span: ExportFileSpan, classes: ClassMap = OWN_CLASSES, layout: DatasetLayout = LAYOUTS["paper"]
) -> FrameLabels:
    """Return the labels of one frame from a file of this layout. Raises a `DatasetFaultError`."""
    listed, arrays = _opened(span, layout.grid)
    members = {member.filename.removesuffix(".npy"): member for member in listed[:MOST_ARRAYS]}
    if layout.label_key not in members:
        what = f"it has no {layout.label_key}, only {', '.join(sorted(members))[:100] or 'no array'}"
        raise DatasetFaultError("DST-062", DatasetPlace(span.name), what)
    grid = arrays.grid_of(members[layout.label_key])
    masks = [_mask(arrays, members[key], key) if key in members else None for key in (MASK_LIDAR, MASK_CAMERA)]
    meant = _meant(span, grid, (masks[0], masks[1]), classes.with_unobserved(layout.grid.unknown))
    return replace(meant, content=arrays.content) if meant.classes is grid and _are_ours(listed, arrays) else meant


def layout_of_labels(span: ExportFileSpan | None, *, has_dashes: bool) -> DatasetLayout:
    """Return the layout of a label file and the form of tokens; if the file cannot be read, only tokens decide."""
    known = recognised_layout((), None, has_dashes=has_dashes)
    if span is None:
        return known
    try:
        listed, arrays = _opened(span, known.grid)
        members = {member.filename.removesuffix(".npy"): member for member in listed[:MOST_ARRAYS]}
        keys = [layout.label_key for layout in LAYOUTS.values() if layout.label_key in members]
        shape = arrays.shape_of(members[keys[0]]) if keys else None
    except (DatasetFaultError, *NO_NPY):
        return known
    return recognised_layout(members, shape, has_dashes=has_dashes)


def _opened(span: ExportFileSpan, grid: LabelGrid) -> tuple[list[zipfile.ZipInfo], "_Arrays"]:
    if span.size_bytes > MOST_PACKED_BYTES:
        raise DatasetFaultError("DST-065", DatasetPlace(span.name), f"it has {span.size_bytes} bytes")
    try:
        content = span.read(MOST_PACKED_BYTES)
        with zipfile.ZipFile(BytesIO(content)) as archive:
            return archive.infolist(), _Arrays(span.name, content, grid)
    except (*UNREADABLE, DamagedExportError) as error:
        raise DatasetFaultError("DST-061", DatasetPlace(span.name), f"it is not a zip ({error})"[:200]) from error


def _are_ours(listed: Sequence[zipfile.ZipInfo], arrays: "_Arrays") -> bool:
    """Return whether a file has each of the three grids once, and otherwise only the platform's optional arrays."""
    names = [member.filename for member in listed]
    further = [member for member in listed if member.filename not in PLAIN]
    is_whole = set(names) >= set(PLAIN) and len(set(names)) == len(names)
    return is_whole and all(map(arrays.is_further, further))


@dataclass(frozen=True)
class _Arrays:
    """The bytes of an npz with arrays of a grid's shape."""

    name: str
    content: bytes
    grid: LabelGrid

    def shape_of(self, member: zipfile.ZipInfo) -> tuple[int, ...]:
        """Return the shape in a member's header. Raises a `DatasetFaultError`, one of `NO_NPY`."""
        return known_head(self._begun(member, self._packed(member), HEAD_BYTES))[0]

    def grid_of(self, member: zipfile.ZipInfo, *, is_mask: bool = False) -> Grid:
        """Return the grid of a member. Raises a `DatasetFaultError`: DST-067 if a mask has another shape or type."""
        packed, position = self._packed(member), DatasetPlace(self.name)
        try:
            shape, is_fortran, dtype, start = known_head(self._begun(member, packed, HEAD_BYTES))
        except NO_NPY as error:
            raise self._damaged(member, "it is not an npy array") from error
        if shape != self.grid.shape:
            what = f"{member.filename} has shape {str(shape)[:60]}; the grid is {self.grid}"
            raise DatasetFaultError("DST-067" if is_mask else "DST-063", position, what, self._turned(shape))
        if dtype != np.uint8 or is_fortran:
            order = "Fortran" if is_fortran else "C"
            raise DatasetFaultError(
                "DST-067" if is_mask else "DST-064",
                position,
                f"{member.filename} is {dtype} in {order} order",
                "write numpy.ascontiguousarray(grid)" if is_fortran else "cast with .astype(numpy.uint8) before saving",
            )
        return self._whole(member, packed, start)

    def _turned(self, shape: tuple[int, ...]) -> str:
        """Return the call that corrects an array of this shape, or "" if it differs in more than its axes."""
        x, y, z = self.grid.shape
        step = {
            (z, x, y): "grid.transpose(1, 2, 0) if your axes are z, x, y; grid.transpose(2, 1, 0) if they are z, y, x",
            (x, z, y): "grid.transpose(0, 2, 1) if your axes are x, z, y; grid.transpose(2, 0, 1) if they are y, z, x",
            (1, x, y, z): "grid[0]: labels have no batch axis",
            (x, y, z, 1): "grid[..., 0]: labels have no channel axis",
        }.get(shape)
        return f"axes are x, y, z: {step}" if step else ""

    def is_further(self, member: zipfile.ZipInfo) -> bool:
        """Return whether the array has one number per voxel with the type of the platform's labels."""
        if member.filename not in FURTHER:
            return False
        dtype_ours = np.dtype(FURTHER[member.filename])
        packed = self._packed(member)
        try:
            shape, is_fortran, dtype, start = known_head(self._begun(member, packed, HEAD_BYTES))
            size = start + dtype_ours.itemsize * self.grid.voxels
            npy = self._begun(member, packed, size + 1)
        except NO_NPY:
            return False
        is_grid = shape == self.grid.shape and dtype == dtype_ours and not is_fortran
        return is_grid and len(npy) == size == member.file_size and isal_zlib.crc32(npy) == member.CRC

    def _whole(self, member: zipfile.ZipInfo, packed: bytes, start: int) -> Grid:
        size = start + self.grid.voxels
        try:
            npy = self._begun(member, packed, size + 1)
        except INFLATING as error:
            raise self._damaged(member, "it cannot be decompressed") from error
        if len(npy) > size:
            raise DatasetFaultError(
                "DST-065", DatasetPlace(self.name), f"{member.filename} continues after its declared {size} bytes"
            )
        if len(npy) < size or member.file_size != size or isal_zlib.crc32(npy) != member.CRC:
            raise self._damaged(member, "it ends early, or its checksum is wrong")
        return np.frombuffer(npy, np.uint8, self.grid.voxels, start).reshape(self.grid.shape)

    def _begun(self, member: zipfile.ZipInfo, packed: bytes, most: int) -> bytes:
        """Return up to `most` decompressed bytes."""
        if member.compress_type == zipfile.ZIP_STORED:
            return packed[:most]
        return bytes(isal_zlib.decompressobj(RAW).decompress(packed, most))

    def _packed(self, member: zipfile.ZipInfo) -> bytes:
        """Return a member's bytes as stored in the file."""
        begin = member.header_offset
        head = self.content[begin : begin + LOCAL_BYTES]
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise self._damaged(member, "it is encrypted, or uses a compression method that npz does not use")
        if len(head) < LOCAL_BYTES or head[:4] != b"PK\3\4":
            raise self._damaged(member, "it is not at the offset in the zip directory")
        start = begin + LOCAL_BYTES + sum(struct.unpack("<2H", head[26:30]))
        return self.content[start : start + member.compress_size]

    def _damaged(self, member: zipfile.ZipInfo, what: str) -> DatasetFaultError:
        return DatasetFaultError("DST-061", DatasetPlace(self.name), f"{member.filename[:80]}: {what}")


def _mask(arrays: _Arrays, member: zipfile.ZipInfo, key: str) -> Grid:
    mask = arrays.grid_of(member, is_mask=True)
    if mask.max() > 1:
        raise DatasetFaultError("DST-068", DatasetPlace(arrays.name), f"{key} has {int(mask.max())}")
    return mask


def _meant(
    span: ExportFileSpan, grid: Grid, masks: tuple[Grid | None, Grid | None], class_map: ClassMap
) -> FrameLabels:
    """Return the labels with the map's meaning of each number."""
    mask_lidar, mask_camera = masks
    if class_map is OWN_CLASSES and grid.max() <= 3:
        return FrameLabels(grid, mask_lidar, mask_camera)
    classes = class_map.meaning[grid]
    if (classes == UNKNOWN).any():
        numbers = np.unique(grid[classes == UNKNOWN]).tolist()
        what = (
            f"the labels have the values {', '.join(map(str, numbers[:20]))}, which {class_map.name!r} does not define"
        )
        raise DatasetFaultError("DST-066", DatasetPlace(span.name), what)
    is_unobserved = classes == UNOBSERVED
    if is_unobserved.any():
        classes[is_unobserved] = 0
        mask_lidar = np.where(is_unobserved, np.uint8(0), np.uint8(1) if mask_lidar is None else mask_lidar)
    return FrameLabels(classes, mask_lidar, mask_camera)
