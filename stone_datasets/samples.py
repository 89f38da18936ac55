"""The sensor files of a published dataset, each read and checked: sweeps, images, radar scans.

**Conventions.** A sweep is read completely; only the start and end of an image are read, not its pixels.
"""

from io import BytesIO

import numpy as np
from PIL import Image, UnidentifiedImageError

from stone.sensors.calibration import CameraIntrinsics
from stone_datasets.faults import DatasetPlace
from stone_exports.cameras import MOST_PICTURE_BYTES
from stone_exports.files import DamagedExportError, ExportFileSpan
from stone_exports.frames import ExportedSensor
from stone_exports.labels import scan_records
from stone_exports.sweeps import COLUMNS, MOST_SWEEP_BYTES
from stone_files.dataset_faults import DatasetFaultError

HEAD_BYTES, END_BYTES = 256 * 1024, 4096
ENDS = {"JPEG": b"\xff\xd9", "PNG": b"IEND"}
UNREADABLE = (OSError, UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError)


def check_sample(
    span: ExportFileSpan, sensor: ExportedSensor, position: DatasetPlace, *, has_no_returns: bool = False
) -> None:
    """Raise a `DatasetFaultError` if the file does not match its sensor; for a LiDAR, as `check_sweep`."""
    if sensor.modality == "lidar":
        check_sweep(span, position, has_no_returns=has_no_returns)
    elif sensor.modality == "camera":
        check_picture(span, sensor.intrinsics, position)
    else:
        check_scan(span, position)


def check_sweep(span: ExportFileSpan, position: DatasetPlace, *, has_no_returns: bool = False) -> None:
    """Check for rows of five float32, all finite unless the layout has rows for shots without a return."""
    if span.size_bytes % (COLUMNS * 4) or not 0 < span.size_bytes <= MOST_SWEEP_BYTES:
        raise DatasetFaultError(
            "DST-051", position, f"{span.name} has {span.size_bytes} bytes, not a multiple of {COLUMNS * 4}"
        )
    try:
        rows = np.frombuffer(span.read(MOST_SWEEP_BYTES), "<f4").reshape(-1, COLUMNS)
    except DamagedExportError as error:
        raise DatasetFaultError(
            "DST-051", position, f"{span.name}: {error.why}; did another program truncate it during reading?"
        ) from error
    is_finite = np.isfinite(rows).all(axis=1)
    if has_no_returns and is_finite.any():
        return
    if not is_finite.all():
        what = (
            f"{span.name}: {len(rows) - int(is_finite.sum())} of {len(rows)} points; the first is point "
            f"{is_finite.argmin()}"
        )
        raise DatasetFaultError("DST-052", position, what)


def check_picture(span: ExportFileSpan, lens: CameraIntrinsics | None, position: DatasetPlace) -> None:
    """Check for a JPEG or PNG with the lens's size and an end marker."""
    form, size_px = picture_of(span, position)
    end = _part(span, max(span.size_bytes - END_BYTES, 0), position)
    if lens is not None and size_px != (lens.width_px, lens.height_px):
        what = f"{span.name} has {size_px[0]} × {size_px[1]} pixels; its row says {lens.width_px} × {lens.height_px}"
        raise DatasetFaultError("DST-055", position, what)
    if ENDS[form] not in end:
        raise DatasetFaultError("DST-054", position, f"{span.name} has no end marker in its last {END_BYTES} bytes")


def picture_of(span: ExportFileSpan, position: DatasetPlace) -> tuple[str, tuple[int, int]]:
    """Return the format (JPEG or PNG), and width and height. Raises `DST-053`."""
    if span.size_bytes > MOST_PICTURE_BYTES:
        raise DatasetFaultError(
            "DST-053", position, f"{span.name} has {span.size_bytes} bytes; the limit is {MOST_PICTURE_BYTES}"
        )
    try:
        with Image.open(BytesIO(_part(span, 0, position)), formats=tuple(ENDS)) as image:
            return str(image.format), image.size
    except UNREADABLE as error:
        raise DatasetFaultError("DST-053", position, f"{span.name} does not start like a JPEG or PNG") from error


def _part(span: ExportFileSpan, start: int, position: DatasetPlace) -> bytes:
    """Return the first bytes of an image from `start`. Raises `DST-054`."""
    try:
        return span.part(start, HEAD_BYTES)
    except DamagedExportError as error:
        raise DatasetFaultError("DST-054", position, f"{span.name}: {error.why}") from error


def check_scan(span: ExportFileSpan, position: DatasetPlace) -> None:
    try:
        scan_records(span)
    except DamagedExportError as error:
        raise DatasetFaultError("DST-056", position, f"{span.name}: {error.why}") from error
