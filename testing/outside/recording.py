"""An analytic drive as a recording: a bag of LiDAR sweeps and a receiver's solutions, and its calibration.

**Conventions.** Time starts at `START_NS`; poses are the receiver's, 50 per second, from before the first sweep until
after the last. World axes are east, north, up at `ORIGIN`. Faults alter a `Recordable`; noise is added after them.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from stone_recordings.messages.types.registry import message_definition, typestore
from testing.outside.ground import Array
from testing.outside.lidar import EGO_FROM_LIDAR, SWEEP_S, Lidar
from testing.outside.track import LENGTH_M, WIDTH_M, Track

START_NS, ORIGIN = 1_777_800_000_000_000_000, (48.1, 11.6, 520.0)
POSE_S, LEAD_S = 0.02, 0.6
EGO_FROM_INS_M = np.array([-0.1, 0.0, 0.5])
RANGE_NOISE_M, POSITION_NOISE_M, ATTITUDE_NOISE_DEG, CORRELATION_S = 0.02, 0.015, 0.1, 2.0
GPS_EPOCH_S, LEAP_S, WEEK_S = 315_964_800, 18, 604_800
SOLUTION_GOOD, RTK_FIXED, RTK_FLOAT = 3, 56, 55
CLOUD, INSPVAX = "sensor_msgs/msg/PointCloud2", "novatel_oem7_msgs/msg/INSPVAX"
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("timestamp", "<f8")])
DATATYPES = {"x": 7, "y": 7, "z": 7, "ring": 4, "timestamp": 8}


@dataclass(frozen=True, eq=False)
class Recordable:
    """The ideal data of a drive: ranges (sweeps, channels, columns), and the receiver's poses after `pose_s` (P,).

    `ego_from_lidar` is the mount in the calibration; the true mount is `EGO_FROM_LIDAR`.
    """

    lidar: Lidar
    ranges_m: NDArray[np.float32]
    pose_s: Array
    world_from_ins: Array
    is_fixed: bool = True
    ego_from_lidar: Array = field(default_factory=EGO_FROM_LIDAR.copy)


def recordable(track: Track, lidar: Lidar, ranges_m: NDArray[np.float32]) -> Recordable:
    """Return the ideal data of a drive."""
    pose_s = np.arange(-LEAD_S, track.seconds + LEAD_S, POSE_S)
    poses = track.poses(pose_s)
    poses[:, :3, 3] += poses[:, :3, :3] @ EGO_FROM_INS_M
    return Recordable(lidar, ranges_m, pose_s, poses)


def correlated(rng: np.random.Generator, count: int, columns: int, seconds: float) -> Array:
    """Return noise (count, columns) of unit variance with a correlation time of `seconds` at the receiver's rate."""
    sigma = seconds / POSE_S
    white = rng.standard_normal((count + int(8 * sigma), columns))
    smooth = gaussian_filter1d(white, sigma, axis=0)[int(4 * sigma) :][:count]
    return np.asarray(smooth * np.sqrt(2 * sigma * np.sqrt(np.pi)))


def turned(poses: Array, turn: Rotation) -> Array:
    """Return poses (P, 4, 4) whose bodies are turned by one rotation, or by one rotation each."""
    after = poses.copy()
    after[:, :3, :3] = poses[:, :3, :3] @ turn.as_matrix()
    return after


def write_recording(drive: Recordable, folder: Path, seed: int) -> tuple[Path, Path]:
    """Write `run.mcap` and `run.calibration.yaml` with the usual noise; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    (bag, calibration), rng = recording_in(folder), np.random.default_rng(seed)
    with bag.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start("ros2", library="stone-outside")
        channels = {}
        for topic, kind in (("/points", CLOUD), ("/inspvax", INSPVAX)):
            schema = writer.register_schema(kind, "ros2msg", message_definition(kind).encode())
            channels[kind] = writer.register_channel(topic, "cdr", schema)
        messages = [*_solutions(drive, rng)]
        for log_ns, kind, message in _in_order(messages, _clouds(drive, rng)):
            writer.add_message(channels[kind], log_ns, bytes(typestore().serialize_cdr(message, kind)), log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    calibration.write_text(json.dumps(_calibration(drive)))
    return bag, calibration


def recording_in(folder: Path) -> tuple[Path, Path]:
    """Return the paths of the bag and the calibration in a folder."""
    return folder / "run.mcap", folder / "run.calibration.yaml"


Logged = tuple[int, str, Any]


def _in_order(solutions: list[Logged], clouds: Iterator[Logged]) -> Iterator[Logged]:
    index = 0
    for cloud in clouds:
        while index < len(solutions) and solutions[index][0] <= cloud[0]:
            yield solutions[index]
            index += 1
        yield cloud
    yield from solutions[index:]


def _header(stamp_ns: int, frame_id: str) -> Any:
    types = typestore().types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9)), frame_id)


def _clouds(drive: Recordable, rng: np.random.Generator) -> Iterator[Logged]:
    types, directions = typestore().types, drive.lidar.directions()
    offsets = {name: POINT.fields[name][1] for name in DATATYPES}  # type: ignore[index]
    fields = [types["sensor_msgs/msg/PointField"](name, offsets[name], code, 1) for name, code in DATATYPES.items()]
    ring, column = np.divmod(np.arange(directions.shape[0] * directions.shape[1]), drive.lidar.columns)
    after_s, flat = drive.lidar.column_seconds()[column], directions.reshape(-1, 3)
    for sweep, ranges in enumerate(drive.ranges_m):
        stamp_ns, seen = START_NS + round(sweep * SWEEP_S * 1e9), np.flatnonzero(np.isfinite(ranges))
        seen = seen[np.argsort(column[seen], kind="stable")]
        measured = ranges.ravel()[seen] + RANGE_NOISE_M * rng.standard_normal(len(seen))
        points = np.zeros(len(seen), POINT)
        points["x"], points["y"], points["z"] = (flat[seen] * measured[:, None]).T
        points["ring"], points["timestamp"] = ring[seen], stamp_ns / 1e9 + after_s[seen]
        size, data = POINT.itemsize, np.frombuffer(points.tobytes(), np.uint8)
        head = _header(stamp_ns, "lidar")
        cloud = types[CLOUD](head, 1, len(seen), fields, False, size, size * len(seen), data, True)
        yield stamp_ns + 105_000_000, CLOUD, cloud


def _solutions(drive: Recordable, rng: np.random.Generator) -> Iterator[Logged]:
    count, types = len(drive.pose_s), typestore().types
    noise = correlated(rng, count, 6, CORRELATION_S)
    attitude = Rotation.from_euler("xyz", ATTITUDE_NOISE_DEG * noise[:, 3:], degrees=True)
    poses = turned(drive.world_from_ins, attitude)
    position = poses[:, :3, 3] + POSITION_NOISE_M * noise[:, :3]
    velocity = np.gradient(position, drive.pose_s, axis=0)
    geodetic = np.stack(pymap3d.enu2geodetic(*position.T, *ORIGIN), axis=1)
    # The receiver: roll, nose up, clockwise from north; its body is x forward, y left, z up.
    yaw, down, roll = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX", degrees=True).T
    angles = np.stack([roll, -down, (90.0 - yaw) % 360.0], axis=1)
    stdev = 0.015 if drive.is_fixed else 0.1
    for row in range(count):
        stamp_ns = START_NS + round(float(drive.pose_s[row]) * 1e9)
        week, of_week_ms = divmod(stamp_ns // 10**6 + (LEAP_S - GPS_EPOCH_S) * 1000, WEEK_S * 1000)
        head = types["novatel_oem7_msgs/msg/Oem7Header"]("INSPVAX", 1465, 0, 0, 180, week, of_week_ms, 0, 40.0)
        status = types["novatel_oem7_msgs/msg/InertialSolutionStatus"](SOLUTION_GOOD)
        solution = types["novatel_oem7_msgs/msg/PositionOrVelocityType"](RTK_FIXED if drive.is_fixed else RTK_FLOAT)
        east, north, up = velocity[row].tolist()
        message = types[INSPVAX](
            _header(stamp_ns + 2_000_000, "gps"), head, status, solution, *geodetic[row].tolist(), 45.5,
            north, east, up, *angles[row].tolist(), *(stdev,) * 3, *(0.02,) * 3, *(0.1,) * 3,
            types["novatel_oem7_msgs/msg/INSExtendedSolutionStatus"](0), 0,
        )  # fmt: skip
        yield stamp_ns + 3_000_000, INSPVAX, message


def _calibration(drive: Recordable) -> dict[str, Any]:
    """Return the native calibration, as JSON, which is YAML; the receiver's own mount is right."""
    ego_from_ins = np.eye(4)
    ego_from_ins[:3, 3] = EGO_FROM_INS_M
    lidar_from_ins = np.linalg.inv(drive.ego_from_lidar) @ ego_from_ins
    ins = {"kind": "ins", "frame_id": "gps", "lidar_from_sensor": _transform(lidar_from_ins), "time_offset_ns": 0}
    return {
        "stone_calibration": 1,
        "name": "outside",
        "footprint": {"length_m": LENGTH_M, "width_m": WIDTH_M},
        "self_boxes_ego": [],
        "ego_from_lidar": _transform(drive.ego_from_lidar),
        "sensors": {"INS": ins},
    }


def _transform(matrix: Array) -> dict[str, list[float]]:
    xyzw = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return {"translation_m": matrix[:3, 3].tolist(), "rotation_wxyz": [float(number) for number in np.roll(xyzw, 1)]}
