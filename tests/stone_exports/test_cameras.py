"""Pictures of exports are undistorted as the lens says; what is no picture of the size that is said is refused."""

import zlib
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from services.labeler.exports.nuscenes.samples import RADAR_RECORD, radar_bytes
from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.projection import project
from stone.sensors.samples import RadarSample
from stone_exports.cameras import undistorted_picture
from stone_exports.files import DamagedExportError, ExportFileSpan, FolderFiles
from stone_exports.frames import ExportedDatum, ExportedSensor, frames_in
from stone_exports.labels import detections_ego

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


def test_a_picture_of_another_size_or_format_is_refused(tmp_path: Path) -> None:
    span = file_of(tmp_path / "a.jpg", picture()[:, :100], "JPEG")
    with pytest.raises(DamagedExportError):
        undistorted_picture(span, LENSES["pinhole"], (WIDTH, HEIGHT))
    with pytest.raises(DamagedExportError):
        undistorted_picture(file_of(tmp_path / "a.gif", picture(), "GIF"), LENSES["pinhole"], (WIDTH, HEIGHT))


@pytest.mark.parametrize("kept", [0, 2, 100, 200])
@pytest.mark.parametrize("form", ["JPEG", "PNG"])
def test_what_is_no_picture_is_refused(form: str, kept: int, tmp_path: Path) -> None:
    span = file_of(tmp_path / "a", picture(), form)
    (tmp_path / "a").write_bytes((tmp_path / "a").read_bytes()[:kept])
    cut = ExportFileSpan(span.path, span.name, 0, kept)
    with pytest.raises(DamagedExportError):
        undistorted_picture(cut, LENSES["plumb_bob"], (WIDTH, HEIGHT))


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


QUARTER = SE3.from_parts(np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)]), np.array([1.0, 0.0, 0.5]))
Rows = NDArray[np.float64]
SEEN = st.tuples(st.floats(1, 200), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-60, 60), st.floats(-40, 40))


def datum_of(path: Path, content: bytes, mount: SE3 = QUARTER) -> ExportedDatum:
    path.write_bytes(content)
    sensor = ExportedSensor("RADAR_FRONT", "radar", mount, None)
    return ExportedDatum(sensor, 0, SE3.identity(), ExportFileSpan(path, path.name, 0, len(content)))


def scan(points: Rows, rates: Rows, rcs_db: Rows) -> bytes:
    return radar_bytes(RadarSample(0, points, points, rates, rates / 2, rcs_db.astype(np.float32)))


@given(st.lists(SEEN, min_size=1, max_size=30))
def test_detections_read_back_are_those_written(tmp_path_factory, seen):
    r, azimuth, elevation, rate, rcs_db = np.array(seen, np.float64).T
    towards = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    points = r[:, None] * towards
    path = tmp_path_factory.getbasetemp() / "scan.pcd"
    found = detections_ego(datum_of(path, scan(points, rate, rcs_db)))
    turn = QUARTER.rotation()
    velocities = (rate / 2)[:, None] * np.column_stack([towards[:, :2], np.zeros(len(r))]) @ turn.T
    wanted = np.column_stack([points @ turn.T + QUARTER.translation_m, rcs_db, velocities[:, :2]])
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-4)


def test_the_scan_of_an_export_lies_on_its_world(rig: Path) -> None:
    datum = frames_in(FolderFiles(rig))[0].data["RADAR_FRONT"]
    found = detections_ego(datum)
    assert len(found) > 20
    assert np.isclose(found[:, 2], 0.1, atol=1e-3).sum() > 20


def test_a_scan_that_saw_nothing_has_no_row(tmp_path: Path) -> None:
    nothing = np.zeros((0, 3))
    assert detections_ego(datum_of(tmp_path / "a.pcd", scan(nothing, nothing[:, 0], nothing[:, 0]))).shape == (0, 6)
    content = sound().replace(b"POINTS 2", b"POINTS 0")
    assert detections_ego(datum_of(tmp_path / "a.pcd", content)).shape == (0, 6)
    head = content[: content.index(b"DATA binary\n") + 12]
    assert detections_ego(datum_of(tmp_path / "a.pcd", head)).shape == (0, 6)


def test_rows_that_are_no_place_are_left_out(tmp_path: Path) -> None:
    records = np.zeros(4, RADAR_RECORD)
    records["x"], records["y"] = [5, np.nan, 1e9, 7], [0, 0, 0, np.inf]
    content = sound()
    head = content[: content.index(b"DATA binary\n") + 12].replace(b"POINTS 2", b"POINTS 4")
    assert len(detections_ego(datum_of(tmp_path / "a.pcd", head + records.tobytes()))) == 1


def test_fields_are_found_by_name_whatever_their_order(tmp_path: Path) -> None:
    record = np.dtype(
        [("rcs", "<f8"), ("vx_comp", "<f4"), ("z", "<f4"), ("y", "<f4"), ("x", "<f4"), ("vy_comp", "<f4")]
    )
    rows = np.array([(9, 1, 0.5, 2, 3, -1)], record)
    head = "FIELDS rcs vx_comp z y x vy_comp\nSIZE 8 4 4 4 4 4\nTYPE F F F F F F\nPOINTS 1\nDATA binary\n"
    found = detections_ego(datum_of(tmp_path / "a.pcd", head.encode() + rows.tobytes(), SE3.identity()))
    assert found.tolist() == [[3, 2, 0.5, 9, 1, -1]]


def sound() -> bytes:
    return scan(np.array([[5.0, 1, 0], [6, 2, 1]]), np.array([1.0, -1]), np.array([3.0, 4]))


LIES = {
    "text": (b"DATA binary", b"DATA ascii"), "compressed": (b"DATA binary", b"DATA binary_compressed"),
    "no head": (sound(), b""), "more points than bytes": (b"POINTS 2", b"POINTS 9"),
    "fewer than none": (b"POINTS 2", b"POINTS -1"), "a count that is none": (b"POINTS 2", b"POINTS two"),
    "a count of a million digits": (b"POINTS 2", b"POINTS " + b"9" * 3000), "no count": (b"POINTS 2\n", b""),
    "a field of three bytes": (b"SIZE 4 4 4", b"SIZE 4 4 3"), "a type that is none": (b"TYPE F", b"TYPE Q"),
    "fewer types than fields": (b"TYPE F F", b"TYPE F"), "a field twice": (b"FIELDS x y", b"FIELDS x x"),
    "no velocity": (b"vx_comp", b"vx_camp"), "several values a field": (b"COUNT 1 1", b"COUNT 1 2"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_heads_that_lie_are_refused(lie: str, tmp_path: Path) -> None:
    old, new = LIES[lie]
    assert old in sound()
    with pytest.raises(DamagedExportError):
        detections_ego(datum_of(tmp_path / "a.pcd", sound().replace(old, new)))


def test_a_scan_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    datum = datum_of(tmp_path / "a.pcd", sound())
    with pytest.raises(DamagedExportError):
        detections_ego(replace(datum, span=replace(datum.span, size_bytes=1 << 30)))
