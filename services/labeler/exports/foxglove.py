"""`<sequence>.mcap`: the labelled sequence for Foxglove, in its own message schemas.

| topic | schema | frame_id |
|---|---|---|
| /tf | foxglove.FrameTransforms: map → ego → LIDAR → every sensor | |
| /labels | foxglove.VoxelGrid: red green blue alpha, and class | ego |
| /LIDAR | foxglove.PointCloud: x y z intensity ring | LIDAR |
| /RADAR_… | foxglove.PointCloud: x y z range_rate ground_rate rcs | the channel |
| /CAM_…/image, /CAM_…/calibration | foxglove.CompressedImage, foxglove.CameraCalibration | the channel |
| /track | foxglove.PosesInFrame: every pose, once | map |
| /map/mesh/0, 1, … | foxglove.SceneUpdate: a part of the mesh each, once | map |

**Conventions.** Sensor messages have their measurement stamp, also as log time; the messages of a frame are sorted by
stamp. Chunks are zstd, indexed. The exporter uses one thread and no clock, so equal inputs give equal bytes. Static
content has its own topic per piece, because a viewer that jumps loads the last message of a topic. Source:
docs.foxglove.dev, MCAP specification.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from foxglove import Context, channels, open_mcap
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import (
    CameraCalibration,
    Color,
    CompressedImage,
    FoxgloveMessage,
    FrameTransform,
    FrameTransforms,
    PackedElementField,
    PackedElementFieldNumericType,
    Point3,
    PointCloud,
    Pose,
    PosesInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
    VoxelGrid,
)
from numpy.typing import NDArray

from services.labeler.exports.meshes import MeshPart, mesh_parts
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step, silent
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_RGB
from stone.labels.grid import Grid
from stone.sensors.calibration import Calibration, CameraIntrinsics
from stone.sensors.samples import CameraSample, LidarSample, RadarSample
from stone_base.label_grid import LabelGrid

CHUNK_BYTES = 4 << 20

Logged = tuple[int, str, FoxgloveMessage]  # log time ns, topic, message


def write_foxglove(source: LabelledSequence, out: Path, step: Step = silent) -> None:
    """Write the file into the folder `out`. Raises what the source raises."""
    total = len(source.sequence.frames)
    options = MCAPWriteOptions(chunk_size=CHUNK_BYTES, compression_threads=0)
    log = _Log(Context())
    with open_mcap(out / f"{source.sequence.name}.mcap", context=log.context, writer_options=options):
        step(0, total)
        for logged in _once(source):
            log.write(logged)
        for index in range(total):
            for logged in sorted(_frame(source, index), key=lambda message: message[0]):
                log.write(logged)
            step(index + 1, total)


class _Log:
    """A channel of the message's schema for every topic, created at its first message."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._channels: dict[str, Any] = {}  # each has its own class, without a base class

    def write(self, logged: Logged) -> None:
        log_time_ns, topic, message = logged
        if topic not in self._channels:
            made = getattr(channels, f"{type(message).__name__}Channel")
            self._channels[topic] = made(topic, context=self.context)
        self._channels[topic].log(message, log_time=log_time_ns)


def _once(source: LabelledSequence) -> Iterator[Logged]:
    """Yield the static messages of the sequence at its first stamp; nothing without frames."""
    frames = source.sequence.frames
    if len(frames):
        first_ns = int(frames.stamps_ns[0])
        yield first_ns, "/track", track(frames.map_from_ego, first_ns)
        for number, part in enumerate(mesh_parts(source.mesh)):
            yield first_ns, f"/map/mesh/{number}", mesh_update(part, number, first_ns)


def _frame(source: LabelledSequence, index: int) -> Iterator[Logged]:
    frames, calibration = source.sequence.frames, source.sequence.calibration
    stamp_ns = int(frames.stamps_ns[index])
    yield stamp_ns, "/tf", transforms(calibration, frames.map_from_ego[index], stamp_ns)
    yield stamp_ns, "/labels", voxel_grid(source.grids(index)["semantics"], source.grid, stamp_ns)
    yield stamp_ns, f"/{LIDAR}", lidar_cloud(source.samples.lidar(index), stamp_ns)
    for mount in calibration.of_kind("radar"):
        if (scan := source.samples.radar(mount.name, index)) is not None:
            yield scan.stamp_ns, f"/{mount.name}", radar_cloud(mount.name, scan)
    for mount in calibration.of_kind("camera"):
        if (picture := source.samples.camera(mount.name, index)) is not None:
            yield picture.stamp_ns, f"/{mount.name}/image", image(mount.name, picture)
            if mount.intrinsics is not None:
                message = camera_calibration(mount.name, mount.intrinsics, picture.stamp_ns)
                yield picture.stamp_ns, f"/{mount.name}/calibration", message


# The platform's values as foxglove messages. Their quaternions are xyzw. A grid's rows run along y and its columns
# along x, in the order z, y, x; free voxels have alpha 0. Bytes are little-endian.


MAP, EGO, LIDAR = "map", "ego", "LIDAR"
LIDAR_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")])
RADAR_POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "range_rate", "ground_rate", "rcs")])
CELL = np.dtype([(name, "u1") for name in ("red", "green", "blue", "alpha", "class")])
CELLS = np.array([(0, 0, 0, 0, 0), *((*CLASS_RGB[kind], 255, kind) for kind in (1, 2, 3))], CELL)
NUMERIC = {
    np.dtype("u1"): PackedElementFieldNumericType.Uint8,
    np.dtype("<u2"): PackedElementFieldNumericType.Uint16,
    np.dtype("<f4"): PackedElementFieldNumericType.Float32,
}
# The platform's names of lens models and Foxglove's; a lens without distortion is plumb_bob with zeros.
LENS = {"pinhole": "plumb_bob", "plumb_bob": "plumb_bob", "rational_polynomial": "rational_polynomial"}
LENS |= {"equidistant": "kannala_brandt"}
NO_DISTORTION = (0.0,) * 5


def timestamp(stamp_ns: int) -> Timestamp:
    return Timestamp(stamp_ns // 10**9, stamp_ns % 10**9)


def pose(transform: SE3) -> Pose:
    """Return one transform as the pose of its source in its destination."""
    return Pose(position=_vector(transform), orientation=_quaternion(transform))


def transforms(calibration: Calibration, map_from_ego: SE3, stamp_ns: int) -> FrameTransforms:
    """Return the whole transform tree at one stamp, so that each message is sufficient."""
    tree = [(MAP, EGO, map_from_ego), (EGO, LIDAR, calibration.ego_from_lidar)]
    tree += [(LIDAR, mount.name, mount.lidar_from_sensor) for mount in calibration.mounts if mount.name != LIDAR]
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=timestamp(stamp_ns),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(parent_from_child),
                rotation=_quaternion(parent_from_child),
            )
            for parent, child, parent_from_child in tree
        ]
    )


def voxel_grid(semantics: Grid, grid: LabelGrid, stamp_ns: int) -> VoxelGrid:
    """Return the classes (X, Y, Z) of a frame with this grid."""
    columns, rows, _ = semantics.shape
    corner = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array(grid.min_m))
    return VoxelGrid(
        timestamp=timestamp(stamp_ns),
        frame_id=EGO,
        pose=pose(corner),
        row_count=rows,
        column_count=columns,
        cell_size=Vector3(x=grid.voxel_m, y=grid.voxel_m, z=grid.voxel_m),
        slice_stride=rows * columns * CELL.itemsize,
        row_stride=columns * CELL.itemsize,
        cell_stride=CELL.itemsize,
        fields=_fields(CELL),
        data=CELLS[np.ascontiguousarray(semantics.transpose(2, 1, 0))].tobytes(),
    )


def lidar_cloud(sample: LidarSample, stamp_ns: int) -> PointCloud:
    points = np.empty(len(sample.points_lidar), LIDAR_POINT)
    points["x"], points["y"], points["z"] = sample.points_lidar.T
    points["intensity"], points["ring"] = sample.intensity, sample.ring
    return _cloud(LIDAR, points, stamp_ns)


def radar_cloud(channel: str, sample: RadarSample) -> PointCloud:
    points = np.empty(len(sample.points_radar), RADAR_POINT)
    points["x"], points["y"], points["z"] = sample.points_radar.T
    points["range_rate"], points["ground_rate"] = sample.range_rate_m_s, sample.ground_rate_m_s
    points["rcs"] = sample.rcs_db
    return _cloud(channel, points, sample.stamp_ns)


def image(channel: str, sample: CameraSample) -> CompressedImage:
    return CompressedImage(timestamp=timestamp(sample.stamp_ns), frame_id=channel, data=sample.content, format="jpeg")


def camera_calibration(channel: str, lens: CameraIntrinsics, stamp_ns: int) -> CameraCalibration:
    """Return the calibration of the picture as recorded; rectification keeps focal lengths and centre."""
    k = [lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0]
    return CameraCalibration(
        timestamp=timestamp(stamp_ns),
        frame_id=channel,
        width=lens.width_px,
        height=lens.height_px,
        distortion_model=LENS[lens.model],
        D=list(lens.distortion or NO_DISTORTION),
        K=k,
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
    )


def track(map_from_ego: SE3, stamp_ns: int) -> PosesInFrame:
    """Return all poses (P,)."""
    poses = [pose(map_from_ego[index]) for index in range(len(map_from_ego))]
    return PosesInFrame(timestamp=timestamp(stamp_ns), frame_id=MAP, poses=poses)


def mesh_update(part: MeshPart, number: int, stamp_ns: int) -> SceneUpdate:
    """Return a permanent entity in the class colours."""
    colours = [Color(r=r, g=g, b=b, a=1.0) for r, g, b in (part.rgb / 255.0).tolist()]
    triangles = TriangleListPrimitive(
        pose=pose(SE3.identity()),
        points=[Point3(x=x, y=y, z=z) for x, y, z in part.vertices_map.tolist()],
        colors=colours,
        indices=part.triangles.reshape(-1).tolist(),
    )
    entity = SceneEntity(
        timestamp=timestamp(stamp_ns), frame_id=MAP, id=f"mesh {number}", frame_locked=True, triangles=[triangles]
    )
    return SceneUpdate(entities=[entity])


def _cloud(frame_id: str, points: NDArray[np.void], stamp_ns: int) -> PointCloud:
    return PointCloud(
        timestamp=timestamp(stamp_ns),
        frame_id=frame_id,
        pose=pose(SE3.identity()),
        point_stride=points.dtype.itemsize,
        fields=_fields(points.dtype),
        data=points.tobytes(),
    )


def _fields(record: np.dtype[np.void]) -> list[PackedElementField]:
    return [
        PackedElementField(name=name, offset=field[1], type=NUMERIC[field[0]])
        for name, field in (record.fields or {}).items()
    ]


def _vector(transform: SE3) -> Vector3:
    x, y, z = transform.translation_m.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(transform: SE3) -> Quaternion:
    w, x, y, z = transform.wxyz.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)
