"""`<sequence>.rrd`: the labelled sequence for the Rerun viewer, with its initial view.

    map                         z up
    map/track, map/mesh/0, …    the robot's track; the surface of the whole run, initially hidden
    map/ego                     the robot's pose
    map/ego/labels              the labelled voxels
    map/ego/LIDAR               the sweep
    map/ego/LIDAR/CAM_…         the camera, its lens and its picture
    map/ego/LIDAR/RADAR_…       the detections, in the LiDAR's axes

**Conventions.** Two timelines: `frame` (number) and `stamp` (UTC, ns); a picture is at its frame and at its own stamp.
One frame is in memory at a time. Ids of chunks and rows follow from their order, so equal inputs give equal chunks; the
order of keys within a chunk is Rerun's and differs between processes.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import Chunk

from services.labeler.exports.meshes import MeshPart, mesh_parts
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step, silent
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_NAME, CLASS_RGB, PAPER
from stone.labels.grid import Grid
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.samples import LidarSample, RadarSample
from stone.sensors.sequence import Sequence
from stone_base.label_grid import LabelGrid

# The platform's values as columns of Rerun's archetypes. An entity's path gives its parent: `map/ego/LIDAR/CAM_FRONT`.
# Transforms are parent_from_child, quaternions xyzw. One row per frame; class ids are those of the labels.


Columns = Iterable[rr.ComponentColumn]

POINT_RADIUS_M, DETECTION_RADIUS_M, TRACK_RADIUS_M = 0.02, 0.12, 0.18
# Intensities beyond this quantile of a sweep have full brightness, so that a retroreflector does not darken the rest.
BRIGHT_QUANTILE = 0.98
RATE_LIMIT_M_S = 3.0
DARK, BRIGHT = np.array([52, 58, 120.0]), np.array([240, 160, 60.0])  # legible on dark and light backgrounds
AWAY, STILL, TOWARDS = np.array([214, 96, 77.0]), np.array([225, 225, 225.0]), np.array([67, 147, 195.0])


def labels_context() -> Columns:
    """Return names and colours of the class ids, for all children of the entity."""
    named: list[Any] = [rr.AnnotationInfo(kind, name, CLASS_RGB[kind]) for kind, name in CLASS_NAME.items()]
    return rr.AnnotationContext.columns(context=named)


def transform(parent_from_child: SE3) -> Columns:
    """Return one row."""
    wxyz = parent_from_child.wxyz
    return rr.Transform3D.columns(
        translation=[parent_from_child.translation_m.astype(np.float32)], quaternion=[np.roll(wxyz, -1).tolist()]
    )


def pinhole(lens: CameraIntrinsics) -> Columns:
    """Return the lens without its distortion, which Rerun does not support."""
    matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])
    return rr.Pinhole.columns(
        image_from_camera=[matrix],
        resolution=[[lens.width_px, lens.height_px]],
        camera_xyz=[rr.components.ViewCoordinates.RDF],
    )


def picture(content: bytes) -> Columns:
    return rr.EncodedImage.columns(blob=[content], media_type=["image/jpeg"])


def voxels(semantics: Grid, grid: LabelGrid) -> Columns:
    """Return the labelled voxels of a frame as boxes in their class colour, in the ego frame."""
    indices = np.argwhere(semantics)
    centres = ((indices + 0.5) * grid.voxel_m + grid.min_m).astype(np.float32)
    boxes = rr.Boxes3D.columns(centers=centres, class_ids=semantics[tuple(indices.T)].astype(np.uint16))
    # Without `show_labels`, a viewer draws class names on the boxes if there are only few.
    shape = rr.Boxes3D.columns(half_sizes=[[grid.voxel_m / 2] * 3], fill_mode=["solid"], show_labels=[False])
    return [*boxes.partition([len(indices)]), *shape]


def returns(sample: LidarSample) -> Columns:
    """Return the sweep, brighter with higher intensity."""
    count = len(sample.points_lidar)
    most = np.quantile(sample.intensity, BRIGHT_QUANTILE) if count else 0.0
    ratio = np.clip(sample.intensity / max(float(most), 1e-6), 0, 1)[:, None]
    colours = _rgba(DARK + ratio * (BRIGHT - DARK))
    points = rr.Points3D.columns(positions=sample.points_lidar, colors=colours).partition([count])
    return [*points, *rr.Points3D.columns(radii=[POINT_RADIUS_M])]


def detections(sample: RadarSample) -> Columns:
    """Return the scan in the LiDAR's axes at the frame's stamp, coloured by speed over ground.

    Red recedes, blue approaches, grey stands still; detections without a position are left out.
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
    """Return a part of the map's surface in the class colours."""
    count = len(part.vertices_map)
    vertices = rr.Mesh3D.columns(
        vertex_positions=part.vertices_map, vertex_normals=_normals(part), vertex_colors=_rgba(part.rgb)
    )
    triangles = rr.Mesh3D.columns(triangle_indices=part.triangles)
    return [*vertices.partition([count]), *triangles.partition([len(part.triangles)])]


def track(positions_map: NDArray[np.float64]) -> Columns:
    """Return the poses (P, 3) as one line, white on the viewer's dark background."""
    return rr.LineStrips3D.columns(strips=[positions_map.astype(np.float32)], colors=[PAPER], radii=[TRACK_RADIUS_M])


def _normals(part: MeshPart) -> NDArray[np.float32]:
    """Return the area-weighted mean normal of the triangles around each vertex."""
    a, b, c = (part.vertices_map[part.triangles[:, corner]] for corner in range(3))
    faces = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    rows, count = part.triangles.reshape(-1), len(part.vertices_map)
    total = np.stack([np.bincount(rows, faces[:, axis], count) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return np.asarray(unit, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class _Numbers:
    """A batch of custom numbers; `rr.AnyValues` would need an object for each."""

    values: NDArray[np.float32]

    def as_arrow_array(self) -> pa.Array:
        return pa.array(self.values)


def _column(name: str, values: NDArray[np.float32]) -> rr.ComponentColumn:
    """Return a value per point, shown when the user points at it."""
    return rr.ComponentColumn(name, _Numbers(values), lengths=[len(values)])


def _rgba(rgb: NDArray[np.generic]) -> NDArray[np.uint32]:
    """Return colours (N, 3), 0 to 255, as Rerun's packed opaque colours."""
    r, g, b = rgb.astype(np.uint32).T
    return np.asarray(r << 24 | g << 16 | b << 8 | 255, dtype=np.uint32)


APPLICATION = "stone"
MAP, EGO, LIDAR = "/map", "/map/ego", "/map/ego/LIDAR"
LABELS, TRACK, MESH = "/map/ego/labels", "/map/track", "/map/mesh"
ROW_ID, CHUNK_ID = "rerun.controls.RowId", b"rerun:id"
RING = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
USUAL_RATE_HZ = 10.0
EYE_EGO_M, LOOK_EGO_M = (-16.0, 6.0, 11.0), (3.0, 0.0, 0.0)


def write_rerun(source: LabelledSequence, out: Path, step: Step = silent) -> None:
    """Write the file into the folder `out`. Raises what the source raises."""
    rr.set_strict_mode(True)  # otherwise Rerun only warns about values that it drops
    total = len(source.sequence.frames)
    recording = rr.RecordingStream(APPLICATION, recording_id=source.sequence.name, send_properties=False)
    numbers = count(1)
    try:
        recording.save(out / f"{source.sequence.name}.rrd", default_view(source.sequence))
        step(0, total)
        recording.send_chunks(_number_chunk(chunk, next(numbers)) for chunk in _once(source))
        for index in range(total):
            recording.send_chunks(_number_chunk(chunk, next(numbers)) for chunk in _frame(source, index))
            step(index + 1, total)
        recording.flush()
    finally:
        recording.disconnect()


def default_view(sequence: Sequence) -> rrb.Blueprint:
    """Return a view of the world between front and rear cameras, playing at the recording's speed."""
    world = rrb.Spatial3DView(
        origin=EGO,
        contents=f"{MAP}/**",
        name="labels",
        overrides={MESH: rrb.EntityBehavior(visible=False)},
        eye_controls=rrb.EyeControls3D(position=EYE_EGO_M, look_target=LOOK_EGO_M, eye_up=(0.0, 0.0, 1.0)),
    )
    mounts = sequence.calibration.of_kind("camera")
    cameras = [
        rrb.Spatial2DView(origin=f"{LIDAR}/{name}", contents="$origin", name=name)
        for name in sorted((mount.name for mount in mounts), key=_place_in_ring)
    ]
    ahead, back = rrb.Horizontal(*cameras[:3]), rrb.Horizontal(*cameras[3:])
    return rrb.Blueprint(
        rrb.Vertical(ahead, world, back, row_shares=[1, 2.2, 1]) if cameras else world,
        rrb.TimePanel(state="collapsed", timeline="frame", fps=_rate_hz(sequence)),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def _place_in_ring(name: str) -> tuple[int, str]:
    return (RING.index(name) if name in RING else len(RING), name)


def _rate_hz(sequence: Sequence) -> float:
    """Return the usual number of frames per second."""
    steps_ns = np.diff(sequence.frames.stamps_ns)
    return float(1e9 / np.median(steps_ns)) if len(steps_ns) else USUAL_RATE_HZ


def _once(source: LabelledSequence) -> Iterator[Chunk]:
    """Yield the static content of the sequence."""
    sequence = source.sequence
    yield _static(MAP, rr.ViewCoordinates.columns(xyz=[rr.components.ViewCoordinates.RIGHT_HAND_Z_UP]))
    yield _static(LABELS, labels_context())
    yield _static(TRACK, track(sequence.frames.map_from_ego.translation_m))
    yield _static(LIDAR, transform(sequence.calibration.ego_from_lidar))
    for mount in sequence.calibration.of_kind("camera"):
        path = f"{LIDAR}/{mount.name}"
        yield _static(path, transform(mount.lidar_from_sensor))
        if mount.intrinsics is not None:
            yield _static(path, pinhole(mount.intrinsics))
    for number, part in enumerate(mesh_parts(source.mesh)):
        yield _static(f"{MESH}/{number}", mesh(part))


def _frame(source: LabelledSequence, index: int) -> Iterator[Chunk]:
    frames, calibration = source.sequence.frames, source.sequence.calibration
    times = _times(index, int(frames.stamps_ns[index]))
    yield Chunk.from_columns(EGO, times, transform(frames.map_from_ego[index]))
    yield Chunk.from_columns(LABELS, times, voxels(source.grids(index)["semantics"], source.grid))
    yield Chunk.from_columns(LIDAR, times, returns(source.samples.lidar(index)))
    for mount in calibration.of_kind("radar"):
        if (scan := source.samples.radar(mount.name, index)) is not None:
            yield Chunk.from_columns(f"{LIDAR}/{mount.name}", times, detections(scan))
    for mount in calibration.of_kind("camera"):
        if (taken := source.samples.camera(mount.name, index)) is not None:
            at = _times(index, taken.stamp_ns)
            yield Chunk.from_columns(f"{LIDAR}/{mount.name}", at, picture(taken.content))


def _static(path: str, columns: Columns) -> Chunk:
    return Chunk.from_columns(path, [], columns)


def _times(index: int, stamp_ns: int) -> list[rr.TimeColumn]:
    stamp = np.array([stamp_ns], "datetime64[ns]")
    return [rr.TimeColumn("frame", sequence=[index]), rr.TimeColumn("stamp", timestamp=stamp)]


def _number_chunk(chunk: Chunk, number: int) -> Chunk:
    """Return the one-row chunk with ids that follow from its number, not from the clock."""
    batch = chunk.to_record_batch()
    row = pa.array([number.to_bytes(16, "big")], pa.binary(16))
    columns = [row if name == ROW_ID else batch.column(name) for name in batch.schema.names]
    named = {**(batch.schema.metadata or {}), CHUNK_ID: b"chunk_%032X" % number}
    renamed = pa.RecordBatch.from_arrays(columns, schema=batch.schema.with_metadata(named))
    return Chunk.from_record_batch(renamed)[0]
