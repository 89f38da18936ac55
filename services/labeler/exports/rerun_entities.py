"""Our values as columns of Rerun's archetypes.

**Conventions.** An entity's path says what it is attached to: `map/ego/LIDAR/CAM_FRONT`. Transforms are
parent_from_child, quaternions xyzw there. One row per frame; class ids are those of the labels.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from services.labeler.exports.mesh_parts import MeshPart
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_NAME, CLASS_RGB, PAPER
from stone.labels.grid import GRID_MIN_M, Grid
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.samples import LidarSample, RadarSample

Columns = Iterable[rr.ComponentColumn]

POINT_RADIUS_M, DETECTION_RADIUS_M, TRACK_RADIUS_M = 0.02, 0.12, 0.18
# Intensities beyond this share of a sweep's points are as bright as can be: a retroreflector must not darken the rest.
BRIGHT_QUANTILE = 0.98
RATE_LIMIT_M_S = 3.0
DARK, BRIGHT = np.array([52, 58, 120.0]), np.array([240, 160, 60.0])  # legible on a dark and on a light ground
AWAY, STILL, TOWARDS = np.array([214, 96, 77.0]), np.array([225, 225, 225.0]), np.array([67, 147, 195.0])


def labels_context() -> Columns:
    """Names and colours of the class ids, for everything below the entity that holds it."""
    named: list[Any] = [rr.AnnotationInfo(kind, name, CLASS_RGB[kind]) for kind, name in CLASS_NAME.items()]
    return rr.AnnotationContext.columns(context=named)


def transform(parent_from_child: SE3) -> Columns:
    """One row."""
    wxyz = parent_from_child.wxyz
    return rr.Transform3D.columns(
        translation=[parent_from_child.translation_m.astype(np.float32)], quaternion=[np.roll(wxyz, -1).tolist()]
    )


def pinhole(lens: CameraIntrinsics) -> Columns:
    """The lens without its distortion, which Rerun does not know."""
    matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])
    return rr.Pinhole.columns(
        image_from_camera=[matrix],
        resolution=[[lens.width_px, lens.height_px]],
        camera_xyz=[rr.components.ViewCoordinates.RDF],
    )


def picture(content: bytes) -> Columns:
    return rr.EncodedImage.columns(blob=[content], media_type=["image/jpeg"])


def voxels(semantics: Grid) -> Columns:
    """The labelled voxels of a frame as boxes of their class, in the ego frame."""
    indices = np.argwhere(semantics)
    centres = ((indices + 0.5) * VOXEL_M + GRID_MIN_M).astype(np.float32)
    boxes = rr.Boxes3D.columns(centers=centres, class_ids=semantics[tuple(indices.T)].astype(np.uint16))
    # Without `show_labels` a viewer writes the name of its class on every one of few boxes.
    shape = rr.Boxes3D.columns(half_sizes=[[VOXEL_M / 2] * 3], fill_mode=["solid"], show_labels=[False])
    return [*boxes.partition([len(indices)]), *shape]


def returns(sample: LidarSample) -> Columns:
    """The sweep, brighter where it reflects more."""
    count = len(sample.points_lidar)
    most = np.quantile(sample.intensity, BRIGHT_QUANTILE) if count else 0.0
    ratio = np.clip(sample.intensity / max(float(most), 1e-6), 0, 1)[:, None]
    colours = _rgba(DARK + ratio * (BRIGHT - DARK))
    points = rr.Points3D.columns(positions=sample.points_lidar, colors=colours).partition([count])
    return [*points, *rr.Points3D.columns(radii=[POINT_RADIUS_M])]


def detections(sample: RadarSample) -> Columns:
    """The scan in the LiDAR's axes at the frame's stamp, coloured by how fast a thing moves over ground.

    Red recedes, blue approaches, grey stands still; detections that cannot be placed are left out.
    """
    kept = np.isfinite(np.column_stack([sample.points_lidar, sample.ground_rate_m_s])).all(axis=1)
    rate = np.clip(sample.ground_rate_m_s[kept] / RATE_LIMIT_M_S, -1, 1)[:, None]
    colours = STILL + np.abs(rate) * (np.where(rate > 0, AWAY, TOWARDS) - STILL)
    count = int(kept.sum())
    positions = sample.points_lidar[kept].astype(np.float32)
    points = rr.Points3D.columns(positions=positions, colors=_rgba(colours)).partition([count])
    measured: dict[str, NDArray[Any]] = {
        "range_rate_m_s": sample.range_rate_m_s[kept],
        "ground_rate_m_s": sample.ground_rate_m_s[kept],
        "rcs_db": sample.rcs_db[kept],
    }
    numbers = [_column(name, values.astype(np.float32)) for name, values in measured.items()]
    return [*points, *rr.Points3D.columns(radii=[DETECTION_RADIUS_M]), *numbers]


def mesh(part: MeshPart) -> Columns:
    """A part of the map's surface in the colours of the classes."""
    count = len(part.vertices_map)
    vertices = rr.Mesh3D.columns(
        vertex_positions=part.vertices_map, vertex_normals=_normals(part), vertex_colors=_rgba(part.rgb)
    )
    triangles = rr.Mesh3D.columns(triangle_indices=part.triangles)
    return [*vertices.partition([count]), *triangles.partition([len(part.triangles)])]


def track(positions_map: NDArray[np.float64]) -> Columns:
    """The poses (P, 3) as one line, white: the viewer's ground is dark."""
    return rr.LineStrips3D.columns(strips=[positions_map.astype(np.float32)], colors=[PAPER], radii=[TRACK_RADIUS_M])


def _normals(part: MeshPart) -> NDArray[np.float32]:
    """Mean of the normals of the triangles round each vertex, weighted by their area."""
    a, b, c = (part.vertices_map[part.triangles[:, corner]] for corner in range(3))
    faces = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    rows, count = part.triangles.reshape(-1), len(part.vertices_map)
    total = np.stack([np.bincount(rows, faces[:, axis], count) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return np.asarray(unit, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Numbers of our own; `rr.AnyValues` takes an object for each."""

    values: NDArray[np.float32]

    def as_arrow_array(self) -> pa.Array:
        return pa.array(self.values)


def _column(name: str, values: NDArray[np.float32]) -> rr.ComponentColumn:
    """What is measured at each point, to be seen where one points at it."""
    return rr.ComponentColumn(name, _Numbers(values), lengths=[len(values)])


def _rgba(rgb: NDArray[np.generic]) -> NDArray[np.uint32]:
    """Colours (N, 3), 0 to 255, as the packed opaque ones that Rerun keeps."""
    r, g, b = rgb.astype(np.uint32).T
    return np.asarray(r << 24 | g << 16 | b << 8 | 255, dtype=np.uint32)
