"""The readers of training data as functions of bytes: frames' tables, labels, radar scans, pictures.

**Conventions.** An input contains six tables, separated by two zeros, beside the files that they name. For
`read_picture`, the first byte selects the lens.
"""

import json
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from PIL import Image

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone_base.label_grid import PAPER
from stone_exports.cameras import undistorted_picture
from stone_exports.files import ExportFileSpan, FolderFiles
from stone_exports.frames import ExportedDatum, ExportedSensor, frames_in
from stone_exports.labels import detections_ego, observed_classes
from stone_exports.tables import TABLES
from stone_files.npz import npz_bytes

TOKEN = "a" * 32
SWEEP, PICTURE = "samples/LIDAR_TOP/s.pcd.bin", "samples/CAM_FRONT/p.jpg"
UPRIGHT = {"translation": [0, 0, 1], "rotation": [1, 0, 0, 0]}
LENS = {
    "camera_intrinsic": [[9, 0, 8], [0, 9, 6], [0, 0, 1]],
    "camera_model": "plumb_bob",
    "camera_distortion": [0.1, 0, 0, 0, 0],
}
OF_A_DATUM = {"sample_token": TOKEN, "ego_pose_token": "p", "timestamp": 17, "is_key_frame": True}
ROWS: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "scene": ({"token": "z", "name": "meadow"},),
    "sample": ({"token": TOKEN, "scene_token": "z", "timestamp": 17},),
    "ego_pose": ({"token": "p", **UPRIGHT},),
    "sensor": (
        {"token": "s", "channel": "LIDAR_TOP", "modality": "lidar"},
        {"token": "t", "channel": "CAM_FRONT", "modality": "camera"},
    ),
    "calibrated_sensor": (
        {"token": "c", "sensor_token": "s", **UPRIGHT},
        {"token": "d", "sensor_token": "t", **UPRIGHT, **LENS},
    ),
    "sample_data": (
        {**OF_A_DATUM, "calibrated_sensor_token": "c", "filename": SWEEP},
        {**OF_A_DATUM, "calibrated_sensor_token": "d", "filename": PICTURE, "width": 16, "height": 12},
    ),
}
LENSES = (
    CameraIntrinsics("pinhole", 16, 12, 9.0, 9.0, 8.0, 6.0),
    CameraIntrinsics("equidistant", 16, 12, 9.0, 9.0, 8.0, 6.0, (0.1, 0.0, 0.0, 0.0)),
)
SCAN_HEAD = "FIELDS x y z rcs vx_comp vy_comp\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\nCOUNT 1 1 1 1 1 1\nPOINTS 2\n"


def read_frames(content: bytes) -> None:
    """Read every frame, and its picture if its lens is small."""
    if not content:
        return
    with TemporaryDirectory() as folder:
        for name, table in zip(ROWS, content.split(b"\0\0", len(ROWS) - 1), strict=False):
            _write(Path(folder) / TABLES / f"{name}.json", table)
        _write(Path(folder) / SWEEP, bytes(60))
        _write(Path(folder) / PICTURE, _picture("JPEG"))
        for frame in frames_in(FolderFiles(Path(folder))):
            for datum in frame.of_modality("camera"):
                lens = datum.sensor.intrinsics
                if lens is not None and lens.width_px * lens.height_px < 1 << 12:
                    undistorted_picture(datum.span, lens, (8, 8))


def read_labels(content: bytes) -> None:
    if content:
        with TemporaryDirectory() as folder:
            observed_classes(_file(folder, content))


def read_scan(content: bytes) -> None:
    """Read its detections, which must be numbers."""
    if not content:
        return
    sensor = ExportedSensor("RADAR_FRONT", "radar", SE3.identity(), None)
    with TemporaryDirectory() as folder:
        rows = detections_ego(ExportedDatum(sensor, 0, SE3.identity(), _file(folder, content)))
    if not np.isfinite(rows).all():
        raise AssertionError(rows)


def read_picture(content: bytes) -> None:
    if content:
        with TemporaryDirectory() as folder:
            undistorted_picture(_file(folder, content[1:]), LENSES[content[0] % len(LENSES)], (8, 8))


def frames_seeds() -> Iterator[tuple[str, bytes]]:
    yield "tables", b"\0\0".join(_table(name) for name in ROWS)


def exported_labels_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield labels as written by the platform, and uncompressed with small arrays, which have fewer zeros to mutate."""
    free = np.zeros(PAPER.shape, np.uint8)
    yield "ours", npz_bytes({"semantics": free, "mask_lidar": free})
    file, small = BytesIO(), BytesIO()
    np.save(small, np.zeros(3, np.uint8))
    with ZipFile(file, "w", ZIP_STORED) as archive:
        for name in ("semantics.npy", "mask_lidar.npy"):
            archive.writestr(name, small.getvalue())
    yield "small", file.getvalue()


def scan_seeds() -> Iterator[tuple[str, bytes]]:
    yield "two", f"{SCAN_HEAD}DATA binary\n".encode() + np.arange(12, dtype="<f4").tobytes()


def picture_seeds() -> Iterator[tuple[str, bytes]]:
    for index, _lens in enumerate(LENSES):
        for form in ("JPEG", "PNG"):
            yield f"{form}-{index}", bytes([index]) + _picture(form)


def _file(folder: str, content: bytes) -> ExportFileSpan:
    path = Path(folder) / "file"
    path.write_bytes(content)
    return ExportFileSpan(path, "file", 0, len(content))


def _picture(form: str) -> bytes:
    file = BytesIO()
    Image.fromarray(np.arange(576, dtype=np.uint16).astype(np.uint8).reshape(12, 16, 3)).save(file, form)
    return file.getvalue()


def _table(name: str) -> bytes:
    return b"[\n" + b",\n".join(json.dumps(row).encode() for row in ROWS[name]) + b"\n]\n"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
