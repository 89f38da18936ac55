"""A frame as models read it: points and detections in the ego frame, undistorted images, labels.

**Conventions.** The ego frame is at the LiDAR's stamp. A camera's `ego_from_camera` includes the robot's pose at its
exposure: camera → ego at exposure → global → ego at the LiDAR's stamp; the same holds for radar detections. Points are
stored in steps of 4 mm up to 131 m, farther points are left out; intensities are whole numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from baselines.inputs import InputConfig
from stone.errors import Refused
from stone.geometry.se3 import SE3
from stone_base.label_grid import PAPER, LabelGrid
from stone_exports.cameras import undistorted_picture
from stone_exports.files import ExportFileSpan
from stone_exports.frames import ExportedDatum, ExportedFrame
from stone_exports.labels import Classes, detections_ego, observed_classes
from stone_exports.sweeps import SweepFile

STEP_M, REACH_M = 0.004, 131.0
JPEG_QUALITY = 95


@dataclass(frozen=True)
class WantedLabels:
    """The grid of labels, and the minimum confidence of their occupied voxels."""

    least_confidence: float = 0.0
    grid: LabelGrid = PAPER


ALL_LABELS = WantedLabels()


@dataclass(frozen=True, eq=False)
class PictureRecord:
    """One image: JPEG of the network's size, its matrix (3, 3) at that size, `ego_from_camera` (4, 4)."""

    jpeg: bytes
    intrinsics: NDArray[np.float64]
    ego_from_camera: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """`returns` (N, 4) float32 x y z intensity, `detections` (R, 6) float32 x y z RCS v_x v_y.

    `labels` are those of `stone_exports.labels.observed_classes`, with 254 and 255.
    """

    token: str
    sequence: str
    stamp_us: int
    global_from_ego: SE3
    returns: NDArray[np.float32]
    detections: NDArray[np.float32]
    pictures: tuple[PictureRecord, ...]
    labels: Classes | None


def read_record(
    frame: ExportedFrame,
    labels: ExportFileSpan | None,
    inputs: InputConfig,
    wanted: WantedLabels = ALL_LABELS,
) -> FrameRecord:
    """Return the parts of a frame that `inputs` names, and its sure labels at the grid.

    Raises `DamagedExportError`, `sensor_missing`, `no_confidence`.
    """
    returns, detections = np.zeros((0, 4), np.float32), np.zeros((0, 6), np.float32)
    if inputs.sees("L") or inputs.with_depth:
        lidar = frame.lidar
        returns = within_reach(SweepFile(lidar.span, lidar.sensor.ego_from_sensor).returns_ego())
    if inputs.sees("R"):
        detections = _detections(frame, inputs)
    pictures = tuple(_pictures(frame, inputs)) if inputs.sees("C") else ()
    classes = None if labels is None else observed_classes(labels, wanted.least_confidence, wanted.grid)
    pose = frame.lidar.global_from_ego
    return FrameRecord(frame.token, frame.sequence, frame.stamp_us, pose, returns, detections, pictures, classes)


def within_reach(returns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the rows (N, 4) within the storable range."""
    kept: NDArray[np.float32] = returns[(np.abs(returns[:, :3]) < REACH_M).all(axis=1)]
    return kept


def _detections(frame: ExportedFrame, inputs: InputConfig) -> NDArray[np.float32]:
    scans = [(datum, detections_ego(datum)) for datum in frame.of_modality("radar")]
    if not scans:
        raise sensor_missing(frame.token, frame.sequence, "radar", inputs.modality)
    placed = [_at_lidar_stamp(frame, datum, rows) for datum, rows in scans]
    return np.concatenate(placed).astype(np.float32)


def _at_lidar_stamp(frame: ExportedFrame, datum: ExportedDatum, rows: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return detections (R, 6) in the ego frame of the LiDAR's stamp, assuming static targets."""
    ego_from_then = frame.lidar.global_from_ego.inverse() @ datum.global_from_ego
    velocities = np.pad(rows[:, 4:].astype(np.float64), ((0, 0), (0, 1))) @ ego_from_then.rotation().T
    points = ego_from_then @ rows[:, :3].astype(np.float64)
    return np.concatenate([points, rows[:, 3:4], velocities[:, :2]], axis=1)


def _pictures(frame: ExportedFrame, inputs: InputConfig) -> Iterator[PictureRecord]:
    height_px, width_px = inputs.image_size_px
    for channel in inputs.channels:
        datum = frame.data.get(channel)
        if datum is None or datum.sensor.intrinsics is None:
            raise sensor_missing(frame.token, frame.sequence, channel, inputs.modality)
        lens = datum.sensor.intrinsics
        pixels = undistorted_picture(datum.span, lens, (width_px, height_px))
        across, down = width_px / lens.width_px, height_px / lens.height_px
        matrix = np.array(
            [
                [lens.fx_px * across, 0.0, (lens.cx_px + 0.5) * across - 0.5],
                [0.0, lens.fy_px * down, (lens.cy_px + 0.5) * down - 0.5],
                [0.0, 0.0, 1.0],
            ]
        )
        mount = frame.lidar.global_from_ego.inverse() @ datum.global_from_ego @ datum.sensor.ego_from_sensor
        yield PictureRecord(_jpeg(pixels), matrix, mount.as_matrix())


def _jpeg(pixels: NDArray[np.uint8]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()


def sensor_missing(token: str, sequence: str, sensor: str, modality: str) -> Refused:
    return Refused(
        "sensor_missing",
        f"frame {token} of {sequence} has no {sensor}, and the row is of modality {modality}: give a row of the "
        "sensors that are there, or leave this sequence out",
    )
