"""A simulated run as a bag of the release: rows topic after topic, one bag time a frame, mounts without translation.

**Conventions.** `RELEASED` contains the known facts of those bags. Camera topics are unknown, so they have the
simulator's names. A frame is a sweep; a radar contributes its list nearest to it, `radar_late_ns` off. The pose of a
frame in `/pva/odom` is the exact pose of an ego origin `ego_height_m` above the ground, as the release's probably is.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from mcap.reader import make_reader
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer

from simulator.options import SimulateOptions
from simulator.pipeline import simulate, sweep_stamps_ns, write_calibration
from simulator.scenery.world import build_world
from simulator.sensors import rig
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone_recordings.messages.types.registry import typestore

CLOUD, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
PICTURE = "sensor_msgs/msg/Image"
DETECTIONS = np.dtype([(name, "<f4") for name in ("x", "y", "z", "v", "rcs")])
FLOAT32 = 7
NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class ReleasedRadar:
    """A radar's topic, frame and direction in `/tf_static`; the number in the frame's name suggests another one."""

    topic: str
    frame_id: str
    yaw_deg: float


@dataclass(frozen=True)
class ReleasedBag:
    """A bag of the release; `mounts_m` are the translations of its `/tf_static` by frame, else 0."""

    lidar_topic: str = "/lidar_points"
    pose_topic: str = "/pva/odom"
    static_topic: str = "/tf_static"
    base_frame: str = "base_link"
    lidar_frame: str = "hesai_lidar"
    lidar_yaw_deg: float = -90.0
    radars: tuple[ReleasedRadar, ...] = (
        ReleasedRadar("/PointCloudDetectionradar1", "ARS_548_240", 0.0),
        ReleasedRadar("/PointCloudDetectionradar2", "ARS_548_0", 120.0),
        ReleasedRadar("/PointCloudDetectionradar3", "ARS_548_120", -120.0),
    )
    radar_late_ns: tuple[int, int] = (-28_000_000, 27_000_000)
    lidar_height_m: float = 0.54
    mounts_m: Mapping[str, tuple[float, float, float]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def ego_height_m(self) -> float:
        """The height of the ego origin above the ground, if the simulated LiDAR has the export's height in it."""
        return float(rig.EGO_FROM_LIDAR.translation_m[2]) - self.lidar_height_m


RELEASED = ReleasedBag()


def write_release_bag(folder: Path, options: SimulateOptions, facts: ReleasedBag = RELEASED) -> Path:
    """Write a database and `metadata.yaml` into the new folder, with the export's calibration beside it."""
    source = folder.with_name(f"{folder.name}.simulated.mcap")
    simulate(source, options)
    write_calibration(_calibration(options, facts), release_calibration(folder))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for topic, kind, rows in _topics(source, options, facts):
            connection = bag.add_connection(topic, kind, typestore=typestore())
            for time_ns, payload in rows:
                bag.write(connection, time_ns, payload)
    source.unlink()
    return folder


def release_calibration(folder: Path) -> Path:
    """Return the path of the calibration of a bag."""
    return folder.with_name(f"{folder.name}.calibration.yaml")


def _calibration(options: SimulateOptions, facts: ReleasedBag) -> Calibration:
    """Return the rig with its ego origin above the ground, without radars, as in the export."""
    made = rig.calibration(options.camera_width_px)
    lidar = SE3.from_parts(made.ego_from_lidar.wxyz, np.array([0.0, 0.0, facts.lidar_height_m]))
    mounts = tuple(mount for mount in made.mounts if mount.kind == "camera")
    boxes = tuple(replace(box, **_lowered(box, facts.ego_height_m)) for box in made.self_boxes_ego)
    return replace(made, ego_from_lidar=lidar, mounts=mounts, self_boxes_ego=boxes)


def _lowered(box: Any, height_m: float) -> dict[str, tuple[float, float, float]]:
    return {name: (x, y, z - height_m) for name in ("min_m", "max_m") for x, y, z in [getattr(box, name)]}


Rows = Iterator[tuple[int, bytes]]


def _topics(source: Path, options: SimulateOptions, facts: ReleasedBag) -> Iterator[tuple[str, str, Rows]]:
    """Yield each topic with all its rows; the rows of a frame have one bag time."""
    stamps_ns = sweep_stamps_ns(options)
    times_ns = [stamp_ns + rig.SWEEP_NS for stamp_ns in stamps_ns]
    recorded = _Recorded(source)
    sweeps = (payload for _, payload in recorded.messages("/lidar_points"))
    yield facts.lidar_topic, CLOUD, zip(times_ns, sweeps, strict=True)
    for number, (radar, channel) in enumerate(zip(facts.radars, rig.RADARS, strict=True)):
        late_ns = np.random.default_rng([options.seed, number]).integers(*facts.radar_late_ns, len(stamps_ns))
        clouds = _radar_clouds(recorded, channel, radar.frame_id, [*zip(stamps_ns, late_ns.tolist(), strict=True)])
        yield radar.topic, CLOUD, zip(times_ns, clouds, strict=True)
    yield facts.pose_topic, ODOMETRY, zip(times_ns, _poses(options, stamps_ns, facts), strict=True)
    for camera in rig.cameras() if options.cameras else ():
        pictures = (_raw(payload) for _, payload in recorded.messages(camera.topic))
        yield camera.topic.replace("/compressed", ""), PICTURE, zip(times_ns, pictures, strict=True)
    yield facts.static_topic, TRANSFORMS, iter([(times_ns[0], _static(facts, stamps_ns[0]))])


class _Recorded:
    """The messages of a simulated recording, topic by topic."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Yield header stamp and payload of each message, in the order of stamps."""
        with self._path.open("rb") as stream:
            messages = make_reader(stream).iter_messages(topics=[topic])
            yield from sorted((_stamp_ns(message.data), message.data) for _, _, message in messages)


def _stamp_ns(payload: bytes) -> int:
    sec, nanosec = np.frombuffer(payload, "<u4", 2, 4).tolist()
    return int(sec * NS_PER_S + nanosec)


def _made(kind: str, **values: Any) -> Any:
    return typestore().types[kind](**values)


def _header(stamp_ns: int, frame_id: str) -> Any:
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    stamp = _made("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return _made("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def _bytes(message: Any, kind: str) -> bytes:
    return bytes(typestore().serialize_cdr(message, kind))


def _radar_clouds(recorded: _Recorded, channel: str, frame_id: str, of: list[tuple[int, int]]) -> Iterator[bytes]:
    """Yield the list nearest to each (stamp, delay), as points."""
    lists = list(recorded.messages(rig.radar_topic(channel)))
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in lists])
    fields = [
        _made("sensor_msgs/msg/PointField", name=name, offset=4 * number, datatype=FLOAT32, count=1)
        for number, name in enumerate(DETECTIONS.names or ())
    ]
    for stamp_ns, late_ns in of:
        _, payload = lists[int(np.abs(stamps_ns - stamp_ns).argmin())]
        points = _points(typestore().deserialize_cdr(payload, "ars548_messages/msg/DetectionList"))
        cloud = _made(
            CLOUD,
            header=_header(stamp_ns + late_ns, frame_id),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=DETECTIONS.itemsize,
            row_step=points.nbytes,
            data=points.view(np.uint8),
            is_dense=True,
        )
        yield _bytes(cloud, CLOUD)


def _points(detections: Any) -> Any:
    listed = detections.list_detections[: detections.list_numofdetections]
    points = np.zeros(len(listed), DETECTIONS)
    for number, detection in enumerate(listed):
        flat_m = detection.f_range * np.cos(detection.f_elevationangle)
        x, y, z = (
            flat_m * np.cos(detection.f_azimuthangle),
            flat_m * np.sin(detection.f_azimuthangle),
            detection.f_range * np.sin(detection.f_elevationangle),
        )
        points[number] = (x, y, z, detection.f_rangerate, detection.s_rcs)
    return points


def _poses(options: SimulateOptions, stamps_ns: list[int], facts: ReleasedBag) -> Iterator[bytes]:
    raised = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, facts.ego_height_m]))
    poses = build_world(options).trajectory.at(np.array(stamps_ns)) @ raised
    for number, stamp_ns in enumerate(stamps_ns):
        vector = _made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = _made("geometry_msgs/msg/Twist", linear=vector, angular=vector)
        position = dict(zip("xyz", poses.translation_m[number].tolist(), strict=True))
        turn = dict(zip("wxyz", poses.wxyz[number].tolist(), strict=True))
        pose = _made(
            "geometry_msgs/msg/Pose",
            position=_made("geometry_msgs/msg/Point", **position),
            orientation=_made("geometry_msgs/msg/Quaternion", **turn),
        )
        odometry = _made(
            ODOMETRY,
            header=_header(stamp_ns, "map"),
            child_frame_id=facts.base_frame,
            pose=_made("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=_made("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )
        yield _bytes(odometry, ODOMETRY)


def _raw(payload: bytes) -> bytes:
    message = typestore().deserialize_cdr(payload, "sensor_msgs/msg/CompressedImage")
    with Image.open(BytesIO(message.data.tobytes())) as jpeg:  # type: ignore[attr-defined]
        pixels = np.asarray(jpeg.convert("RGB"))
    height, width, _ = pixels.shape
    picture = _made(
        PICTURE,
        header=message.header,  # type: ignore[attr-defined]
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * width,
        data=pixels.ravel(),
    )
    return _bytes(picture, PICTURE)


def _static(facts: ReleasedBag, stamp_ns: int) -> bytes:
    yaws_deg = {facts.lidar_frame: facts.lidar_yaw_deg} | {radar.frame_id: radar.yaw_deg for radar in facts.radars}
    transforms = []
    for frame, yaw_deg in yaws_deg.items():
        half = np.deg2rad(yaw_deg) / 2
        x, y, z = facts.mounts_m.get(frame, (0.0, 0.0, 0.0))
        turn = _made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(half)), w=float(np.cos(half)))
        translation = _made("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
        transforms.append(
            _made(
                "geometry_msgs/msg/TransformStamped",
                header=_header(stamp_ns, facts.base_frame),
                child_frame_id=frame,
                transform=_made("geometry_msgs/msg/Transform", translation=translation, rotation=turn),
            )
        )
    return _bytes(_made(TRANSFORMS, transforms=transforms), TRANSFORMS)
