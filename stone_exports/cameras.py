"""Lenses and images of an export: intrinsics from `calibrated_sensor`, and images undistorted to an ideal pinhole.

**Conventions.** Optical frame: z forward, x right, y down; pixel (0, 0) is the centre of the first pixel. Images are
undistorted to a pinhole with the same focal length by bilinear interpolation (`stone.sensors.projection`).
"""

from collections.abc import Mapping
from functools import lru_cache
from io import BytesIO
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from stone.sensors.calibration import CameraIntrinsics, CameraModel
from stone.sensors.projection import project
from stone_exports.files import ExportContent, Files
from stone_exports.tables import table_span

COEFFICIENTS: Mapping[CameraModel, int] = {"pinhole": 0, "plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
MOST_PICTURE_BYTES, MOST_PIXELS = 64 * 2**20, 1 << 26
Pixels = NDArray[np.uint8]


def intrinsics_of(files: Files, row: Mapping[str, Any], size_px: tuple[int, int]) -> CameraIntrinsics:
    """Return the lens in a row of `calibrated_sensor`. Raises `DamagedExportError` if it is invalid."""
    model = row.get("camera_model", "pinhole")
    try:
        matrix = np.array(row["camera_intrinsic"], np.float64)
        distortion = np.array(row.get("camera_distortion", []), np.float64)
    except (KeyError, ValueError, TypeError, OverflowError):
        matrix, distortion = np.zeros(0), np.zeros(0)
    is_sound = matrix.shape == (3, 3) and np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0
    if not is_sound or model not in get_args(CameraModel) or not np.isfinite(distortion).all():
        raise table_span(files, "calibrated_sensor").damaged("a camera has an invalid matrix or model")
    if distortion.shape != (COEFFICIENTS[model],):
        raise table_span(files, "calibrated_sensor").damaged(
            f"a {model} camera has {distortion.size} distortion coefficients; expected {COEFFICIENTS[model]}"
        )
    (fx, _, cx), (_, fy, cy) = matrix[0], matrix[1]
    return CameraIntrinsics(model, *size_px, fx, fy, cx, cy, tuple(distortion.tolist()))


def undistorted_picture(span: ExportContent, lens: CameraIntrinsics, size_px: tuple[int, int]) -> Pixels:
    """Return the undistorted image, resized to `size_px` (width, height), shape (height, width, 3) uint8.

    Raises `DamagedExportError` if it is not a JPEG with the tables' size.
    """
    picture = _decoded(span, (lens.width_px, lens.height_px), size_px if _is_straight(lens) else None)
    if not _is_straight(lens):
        picture = Image.fromarray(_remapped(np.asarray(picture), *_sources(lens)))
    return np.asarray(picture.resize(size_px, Image.Resampling.BILINEAR, reducing_gap=2.0))


def recorded_picture(span: ExportContent, lens: CameraIntrinsics | None) -> Pixels:
    """Return the original image, shape (height, width, 3) uint8. Raises `DamagedExportError` as above."""
    return np.asarray(_decoded(span, None if lens is None else (lens.width_px, lens.height_px), None))


def _decoded(span: ExportContent, size_px: tuple[int, int] | None, wanted_px: tuple[int, int] | None) -> Image.Image:
    """Return the decoded image, checked against its size; the decoder may halve it down to `wanted_px`."""
    try:
        with Image.open(BytesIO(span.read(MOST_PICTURE_BYTES)), formats=("JPEG", "PNG")) as image:
            if image.size != (size_px or image.size) or image.width * image.height > MOST_PIXELS:
                raise span.damaged(f"its size of {image.width} × {image.height} pixels contradicts the tables")
            if wanted_px is not None:
                image.draft("RGB", wanted_px)
            return image.convert("RGB")
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError) as error:
        raise span.damaged("it is not an image") from error


def _is_straight(lens: CameraIntrinsics) -> bool:
    return lens.model != "equidistant" and not any(lens.distortion)


@lru_cache(maxsize=16)
def _sources(lens: CameraIntrinsics) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the lens position of each pinhole pixel (height · width, 2), and whether it lies in the image."""
    v, u = np.mgrid[0 : lens.height_px, 0 : lens.width_px].astype(np.float64)
    rays = np.stack([(u - lens.cx_px) / lens.fx_px, (v - lens.cy_px) / lens.fy_px, np.ones_like(u)], axis=-1)
    pixels, is_seen = project(rays.reshape(-1, 3), lens)
    return pixels.astype(np.float32), is_seen


def _remapped(picture: Pixels, sources: NDArray[np.float32], is_seen: NDArray[np.bool_]) -> Pixels:
    """Return the image (H, W, 3) sampled at `sources` (H · W, 2), bilinear; unseen pixels are black."""
    height, width, _ = picture.shape
    at = np.where(is_seen[:, None], sources, np.float32(0)).clip(0, (width - 1, height - 1))
    corner = np.minimum(np.floor(at).astype(np.int64), (max(width - 2, 0), max(height - 2, 0)))
    right, down = np.minimum(corner[:, 0] + 1, width - 1), np.minimum(corner[:, 1] + 1, height - 1)
    (a, b), pixels = (at - corner).T[:, :, None], picture.astype(np.float32)
    above = pixels[corner[:, 1], corner[:, 0]] * (1 - a) + pixels[corner[:, 1], right] * a
    below = pixels[down, corner[:, 0]] * (1 - a) + pixels[down, right] * a
    mixed = (above * (1 - b) + below * b) * is_seen[:, None]
    remapped: Pixels = np.rint(mixed).astype(np.uint8).reshape(picture.shape)
    return remapped
