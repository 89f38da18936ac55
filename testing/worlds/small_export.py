"""A small export of the nuScenes layout, written by formula in a few milliseconds, without recording or labelling.

**Conventions.** The ground is flat, 0.1 m above the ego origin: traversable within 1 m of the map's x axis, potentially
traversable elsewhere, with boxes on it. Labels are exact within 3.2 m of the robot; voxels farther away are unobserved.
Sweeps are points of the same surfaces, so earlier sweeps fit later ones.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.labeler.exports.nuscenes.samples import lidar_bytes, radar_bytes
from stone.geometry.se3 import SE3
from stone.sensors.samples import LidarSample, RadarSample
from stone.sensors.sequence import frame_token
from stone_base.label_grid import PAPER, LabelGrid
from stone_exports.tables import TABLES
from stone_files.npz import npz_bytes

START_US, STEP_US, EXPOSURE_US, SCAN_US = 1_700_000_000_000_000, 100_000, -20_000, -30_000
GROUND_M, REACH_M, SEEN_M = 0.1, 5.0, 3.2
BOXES = ((1.6, 1.2, 0.4, 1.0), (2.9, -1.4, 0.5, 0.7), (-1.9, 1.9, 0.6, 0.9))  # x y, half a side, height
CAMERAS = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
PICTURE_PX = (64, 48)
FOCAL_PX = 40.0
LIDAR_M = (0.1, 0.0, 1.0)
Points = NDArray[np.float64]


@dataclass(frozen=True)
class SmallExport:
    """The export to write. `lens` applies to all cameras: its model, and coefficients of distortion.

    Tokens are those of the sequence's name and stamps, unless they are `named`.
    """

    sequence: str = "meadow"
    frames: int = 6
    cameras: Sequence[str] = ()
    radars: Sequence[str] = ()
    is_labelled: bool = True
    named: Sequence[str] = ()
    lens: tuple[str, tuple[float, ...]] = ("plumb_bob", (-0.05, 0.01, 0.0, 0.0, 0.0))
    grid: LabelGrid = PAPER

    def stamp_us(self, index: int) -> int:
        return START_US + index * STEP_US

    @property
    def tokens(self) -> tuple[str, ...]:
        stamps_ns = (self.stamp_us(index) * 1000 for index in range(self.frames))
        return tuple(self.named) or tuple(frame_token(self.sequence, stamp_ns) for stamp_ns in stamps_ns)


def global_from_ego(stamp_us: int) -> SE3:
    """Return a pose on a gentle curve at three metres per second, far from the origin."""
    steps = (stamp_us - START_US) / STEP_US
    half_rad = 0.01 * steps
    wxyz = np.array([np.cos(half_rad), 0.0, 0.0, np.sin(half_rad)])
    return SE3.from_parts(wxyz, np.array([800 + 0.3 * steps, 600 + 0.02 * steps**2, 50.0]))


def classes_of(points_ego: Points, pose: SE3, voxel_m: float = PAPER.voxel_m) -> NDArray[np.uint8]:
    """Return the class (N,) of the voxel around each point of the ego frame."""
    x, y, z = (pose @ points_ego - (800, 600, 50)).T
    is_ground = np.abs(z - GROUND_M) < voxel_m / 2 - 1e-6
    classes = np.where(is_ground, np.where(np.abs(y) < 1, 1, 2), 0).astype(np.uint8)
    for at_x, at_y, half, high in BOXES:
        is_in = (np.abs(x - at_x) < half) & (np.abs(y - at_y) < half) & (z > GROUND_M) & (z < GROUND_M + high)
        classes[is_in] = 3
    return classes


def labels_of(pose: SE3, grid: LabelGrid = PAPER) -> bytes:
    """Return `labels.npz` of a frame at this pose, as the layout of the grid has it."""
    semantics, seen = np.zeros(grid.shape, np.uint8), np.zeros(grid.shape, np.uint8)
    low, high = (round((side * SEEN_M - grid.min_m[0]) / grid.voxel_m) for side in (-1, 1))
    columns = np.arange(low, high)
    voxels = np.stack(np.meshgrid(columns, columns, np.arange(grid.shape[2]), indexing="ij"), axis=-1).reshape(-1, 3)
    places, centres_ego = tuple(voxels.T), (voxels + 0.5) * grid.voxel_m + np.array(grid.min_m)
    semantics[places] = classes_of(centres_ego, pose, grid.voxel_m)
    seen[places] = voxels[:, 2] >= math.floor(-grid.min_m[2] / grid.voxel_m)
    if grid.unknown is not None:
        return npz_bytes({"label": np.where((seen == 0) & (semantics == 0), np.uint8(grid.unknown), semantics)})
    return npz_bytes({"semantics": semantics, "mask_lidar": seen, "mask_camera": seen})


def surface_points(pose: SE3, seed: int, count: int = 1200) -> Points:
    """Return points (N, 3) of ground and of boxes' tops near the robot, ego frame."""
    random = np.random.default_rng(seed)
    spread = random.uniform(-REACH_M, REACH_M, (count, 2))
    ground = np.column_stack([spread, np.full(count, GROUND_M)])
    tops = [
        np.column_stack([np.add(random.uniform(-half, half, (60, 2)), (x, y)), np.full(60, GROUND_M + high - 0.05)])
        for x, y, half, high in BOXES
    ]
    return np.concatenate([ground, pose.inverse() @ np.add(np.concatenate(tops), (800, 600, 50))])


def write_small_export(folder: Path, export: SmallExport) -> Path:
    """Write the export and return its folder."""
    tables: dict[str, list[dict[str, Any]]] = {name: [] for name in ("sample", "ego_pose", "sample_data")}
    tables["scene"] = [{"token": "scene", "name": export.sequence}]
    tables["sensor"] = [
        {"token": f"sensor-{channel}", "channel": channel, "modality": _modality(channel)}
        for channel in ("LIDAR_TOP", *export.cameras, *export.radars)
    ]
    tables["calibrated_sensor"] = [_mounted(export, row) for row in tables["sensor"]]
    for index, token in enumerate(export.tokens):
        stamp_us = export.stamp_us(index)
        tables["sample"].append({"token": token, "scene_token": "scene", "timestamp": stamp_us})
        for sensor in tables["sensor"]:
            _add_datum(folder, tables, (token, stamp_us, sensor["channel"]))
        if export.is_labelled:
            labels = folder / "gts" / export.sequence / token / "labels.npz"
            labels.parent.mkdir(parents=True)
            labels.write_bytes(labels_of(global_from_ego(stamp_us), export.grid))
    for name, rows in tables.items():
        write_table(folder, name, rows)
    return folder


def write_table(folder: Path, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a row per line, as exports do."""
    path = folder / TABLES / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


def picture_of(stamp_us: int, channel: str) -> bytes:
    """Return a JPEG of slow waves, different for each camera and time."""
    width, height = PICTURE_PX
    v, u = np.mgrid[0:height, 0:width]
    phase = stamp_us / STEP_US + 0.7 * len(channel)
    waves = [np.sin(u / 9 + phase), np.cos(v / 7 - phase), np.sin((u + v) / 11 + phase)]
    file = BytesIO()
    Image.fromarray((127 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)).save(file, "JPEG", quality=95)
    return file.getvalue()


def _add_datum(folder: Path, tables: Mapping[str, list[dict[str, Any]]], what: tuple[str, int, str]) -> None:
    token, frame_us, channel = what
    stamp_us = frame_us + {"lidar": 0, "camera": EXPOSURE_US, "radar": SCAN_US}[_modality(channel)]
    name = f"samples/{channel}/{channel}__{stamp_us}.{_ending(channel)}"
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(_content(stamp_us, channel))
    pose, pose_token = global_from_ego(stamp_us), f"pose-{channel}-{stamp_us}"
    pose_fields = {"rotation": pose.wxyz.tolist(), "translation": pose.translation_m.tolist()}
    tables["ego_pose"].append({"token": pose_token, "timestamp": stamp_us, **pose_fields})
    datum = {
        "token": f"datum-{channel}-{stamp_us}",
        "sample_token": token,
        "ego_pose_token": pose_token,
        "calibrated_sensor_token": f"mount-{channel}",
        "timestamp": stamp_us,
        "is_key_frame": True,
        "filename": name,
    }
    size = dict(zip(("width", "height"), PICTURE_PX, strict=True)) if _modality(channel) == "camera" else {}
    tables["sample_data"].append(datum | size)


def _content(stamp_us: int, channel: str) -> bytes:
    if _modality(channel) == "camera":
        return picture_of(stamp_us, channel)
    points = (surface_points(global_from_ego(stamp_us), stamp_us % 1000_003) - LIDAR_M).astype(np.float32)
    if _modality(channel) == "radar":
        sparse = points[::40].astype(np.float64)
        rates = np.linspace(-2, 2, len(sparse))
        return radar_bytes(RadarSample(0, sparse, sparse, rates, rates + 1, np.full(len(sparse), 5, np.float32)))
    rings = np.zeros(len(points), np.uint16)
    return lidar_bytes(LidarSample(points, np.arange(len(points), dtype=np.float32) % 200, rings))


def _mounted(export: SmallExport, sensor: Mapping[str, Any]) -> dict[str, Any]:
    row = {"token": f"mount-{sensor['channel']}", "sensor_token": sensor["token"], "translation": list(LIDAR_M)}
    if sensor["modality"] != "camera":
        return {**row, "rotation": [1.0, 0.0, 0.0, 0.0], "camera_intrinsic": []}
    (width, height), (model, distortion) = PICTURE_PX, export.lens
    matrix = [[FOCAL_PX, 0, (width - 1) / 2], [0, FOCAL_PX, (height - 1) / 2], [0, 0, 1]]
    looks = {"rotation": _looking(export.cameras.index(sensor["channel"]), len(export.cameras))}
    return {**row, **looks, "camera_intrinsic": matrix, "camera_model": model, "camera_distortion": list(distortion)}


def _looking(place: int, of: int) -> list[float]:
    """Return `ego_from_camera` as wxyz: level, the first ahead, the others around the robot."""
    yaw = 2 * np.pi * place / of
    turn = SE3.from_parts(np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]), np.zeros(3))
    ahead = SE3.from_parts(np.array([0.5, -0.5, 0.5, -0.5]), np.zeros(3))
    return [float(part) for part in (turn @ ahead).wxyz]


def _modality(channel: str) -> str:
    return {"LIDAR": "lidar", "CAM": "camera", "RADAR": "radar"}[channel.partition("_")[0]]


def _ending(channel: str) -> str:
    return {"lidar": "pcd.bin", "camera": "jpg", "radar": "pcd"}[_modality(channel)]
