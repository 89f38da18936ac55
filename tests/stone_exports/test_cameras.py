"""Pictures of exports are undistorted as the lens says; what is no picture of the size that is said is refused."""

import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.projection import project
from stone_exports.cameras import undistorted_picture
from stone_exports.files import DamagedExportError, ExportFileSpan

WIDTH, HEIGHT = 120, 90
LENSES = {
    "pinhole": CameraIntrinsics("pinhole", WIDTH, HEIGHT, 80.0, 82.0, 58.3, 46.1),
    "plumb_bob": CameraIntrinsics(
        "plumb_bob", WIDTH, HEIGHT, 80.0, 82.0, 58.3, 46.1, (-0.25, 0.06, 0.002, -0.001, 0.01)
    ),
    "rational_polynomial": CameraIntrinsics(
        "rational_polynomial", WIDTH, HEIGHT, 80.0, 82.0, 58.3, 46.1, (0.3, 0.02, 1e-3, -1e-3, 0.01, 0.5, 0.05, 0.01)
    ),
    "equidistant": CameraIntrinsics(
        "equidistant", WIDTH, HEIGHT, 60.0, 61.0, 58.3, 46.1, (-0.02, 0.004, -0.001, 0.0002)
    ),
}


def file_of(path: Path, pixels: NDArray[np.uint8], form: str = "PNG") -> ExportFileSpan:
    Image.fromarray(pixels).save(path, form)
    return ExportFileSpan(path, path.name, 0, path.stat().st_size)


def picture(seed: int = 1) -> NDArray[np.uint8]:
    """Smooth, and another colour at every place."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([2 * u, 2 * v, (u + v + seed) % 256], axis=-1).astype(np.uint8)


def colour_at(pixels: NDArray[np.uint8], u: float, v: float) -> NDArray[np.float64]:
    """Bilinear between the four pixels around (u, v), the last ones repeated beyond the edge."""
    u, v = min(max(u, 0), WIDTH - 1), min(max(v, 0), HEIGHT - 1)
    column, row = int(u), int(v)
    mixed = np.zeros(3)
    for down in (0, 1):
        for right in (0, 1):
            weight = (right * (u - column) + (1 - right) * (1 - u + column)) * (
                down * (v - row) + (1 - down) * (1 - v + row)
            )
            mixed += weight * pixels[min(row + down, HEIGHT - 1), min(column + right, WIDTH - 1)]
    return mixed


@pytest.mark.parametrize("model", LENSES)
def test_a_point_that_the_lens_sees_lands_where_the_pinhole_says(model: str, tmp_path: Path) -> None:
    """Pixel by pixel: the ray of a pixel of the pinhole, seen through the lens, has that pixel's colour."""
    lens, pixels = LENSES[model], picture()
    found = undistorted_picture(file_of(tmp_path / "a.png", pixels), lens, (WIDTH, HEIGHT))
    seen = 0
    for row in range(0, HEIGHT, 3):
        for column in range(0, WIDTH, 3):
            ray = np.array([[(column - lens.cx_px) / lens.fx_px, (row - lens.cy_px) / lens.fy_px, 1.0]])
            (at,), (is_seen,) = project(7.0 * ray, lens)
            wanted = colour_at(pixels, *at) if is_seen else np.zeros(3)
            assert np.abs(found[row, column] - wanted).max() <= 1, (row, column)
            seen += is_seen
    assert seen > 600
    assert model == "pinhole" or not np.array_equal(found, pixels)


def test_a_straight_picture_is_left_as_it_is(tmp_path: Path) -> None:
    found = undistorted_picture(file_of(tmp_path / "a.png", picture()), LENSES["pinhole"], (WIDTH, HEIGHT))
    assert np.array_equal(found, picture())


@pytest.mark.parametrize("model", ["pinhole", "plumb_bob"])
@pytest.mark.parametrize("size_px", [(60, 45), (30, 30), (240, 90)])
def test_resizing_keeps_places(model: str, size_px: tuple[int, int], tmp_path: Path) -> None:
    """A pixel's centre is at (u + ½) · ratio − ½ afterwards: a ramp says where it came from, a JPEG's too."""
    width, height = size_px
    lens = LENSES[model]
    whole = undistorted_picture(file_of(tmp_path / "a.jpg", picture(), "JPEG"), lens, (WIDTH, HEIGHT)).astype(float)
    found = undistorted_picture(file_of(tmp_path / "b.jpg", picture(), "JPEG"), lens, size_px).astype(float)
    rows, columns = np.mgrid[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4]
    back_u, back_v = (columns + 0.5) * WIDTH / width - 0.5, (rows + 0.5) * HEIGHT / height - 0.5
    for channel in (0, 1):
        wanted = [
            [colour_at(whole, u, v)[channel] for u, v in zip(*line, strict=True)]
            for line in zip(back_u, back_v, strict=True)
        ]
        assert np.abs(found[rows, columns, channel] - wanted).mean() < 1.5


def test_a_picture_of_one_pixel_is_one(tmp_path: Path) -> None:
    lens = CameraIntrinsics("plumb_bob", 1, 1, 1.0, 1.0, 0.0, 0.0, (0.1, 0.0, 0.0, 0.0, 0.0))
    found = undistorted_picture(file_of(tmp_path / "a.png", picture()[:1, :1]), lens, (4, 4))
    assert found.shape == (4, 4, 3)


def test_a_picture_of_another_size_is_refused(tmp_path: Path) -> None:
    span = file_of(tmp_path / "a.jpg", picture()[:, :100], "JPEG")
    with pytest.raises(DamagedExportError, match=r"it has 100 × 90 pixels, the tables say otherwise"):
        undistorted_picture(span, LENSES["pinhole"], (WIDTH, HEIGHT))


@pytest.mark.parametrize("kept", [0, 2, 100, 200])
@pytest.mark.parametrize("form", ["JPEG", "PNG"])
def test_what_is_no_picture_is_refused(form: str, kept: int, tmp_path: Path) -> None:
    span = file_of(tmp_path / "a", picture(), form)
    (tmp_path / "a").write_bytes((tmp_path / "a").read_bytes()[:kept])
    cut = ExportFileSpan(span.path, span.name, 0, kept)
    with pytest.raises(DamagedExportError, match="it is not an image"):
        undistorted_picture(cut, LENSES["plumb_bob"], (WIDTH, HEIGHT))


def test_formats_that_no_export_has_are_not_opened(tmp_path: Path) -> None:
    with pytest.raises(DamagedExportError, match="it is not an image"):
        undistorted_picture(file_of(tmp_path / "a.gif", picture(), "GIF"), LENSES["pinhole"], (WIDTH, HEIGHT))


def test_a_picture_of_a_billion_pixels_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    """The head of a PNG says what it is; nothing of that size is made."""
    content = BytesIO()
    Image.fromarray(picture()).save(content, "PNG")
    forged = bytearray(content.getvalue())
    forged[16:24] = (30_000).to_bytes(4, "big") + (30_000).to_bytes(4, "big")
    forged[29:33] = zlib.crc32(bytes(forged[12:29])).to_bytes(4, "big")
    (tmp_path / "a.png").write_bytes(bytes(forged))
    lens = CameraIntrinsics("pinhole", 30_000, 30_000, 80.0, 82.0, 58.3, 46.1)
    with pytest.raises(DamagedExportError):
        undistorted_picture(ExportFileSpan(tmp_path / "a.png", "a.png", 0, len(forged)), lens, (64, 64))
