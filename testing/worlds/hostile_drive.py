"""A drive of one second over flat ground in which a stranger may put any value anywhere: attacks are a few lines each.

**Conventions.** `arrays` are the recorded values, in the types of messages, and the calibration's values. The robot
drives along x, tilted a little, 300 m from the start of its odometry, and its LiDAR is mounted with a yaw of 45°. Edits
in bytes are for a fuzzer: any bytes are edits, and each sets an arbitrary value or one that breaks arithmetic.
"""

import json
import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone_recordings.messages.types.registry import message_definition, typestore

FRAMES, POSES = 8, 20
START_S, SWEEP_NS, POSE_NS = 1_760_000_000, 100_000_000, 50_000_000
STEP_M, FIRST_M, HEIGHT_M = 0.3, (300.0, -200.0, 10.0), 1.2
REACH_M, SPACING_M = 4.0, 0.16
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("timestamp", "<f8")])
CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
DATATYPES = {"f4": 7, "f8": 8, "u2": 4}
# Each breaks arithmetic: NaN, infinity, values below or at the ends of a type's range, and values beyond a map.
FLOATS = (
    np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e-45, 1e-30, -1e-30, 3e38, -3e38, 1e38, 1e30, -1e30, 1e300, -1e300,
    1e154, 1e19, 9.3e18, -9.3e18, 1e15, 1e9, 4.3e9, 1e6, 1e5, 1e4, 1e3, -1e3, 999.9, 200.0, 40.0, 1.0, -1.0, 0.5, 1e-3,
)  # fmt: skip
INTEGERS = (0, 1, -1, 2, 7, 255, 2**15, 2**16 - 1, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, -(2**63), 2**64 - 1)
EDIT, ANY, ALL = struct.Struct("<BHBBQ"), 255, 1 << 15
RAYS_FOLLOWED = 41_000  # a point of a frame whose rays are followed

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Edit:
    """`array` from element `first` on, `count` of them, `step` apart, becomes `value`."""

    array: str
    first: int
    count: int
    step: int
    value: float | int

    def apply(self, arrays: Arrays) -> None:
        flat = arrays[self.array].reshape(-1)
        places = (self.first + self.step * np.arange(min(self.count, flat.size))) % flat.size
        with np.errstate(all="ignore"):
            if flat.dtype.kind == "f":
                flat[places] = np.float64(self.value)
            else:
                flat[places] = np.array(int(self.value) & (2**64 - 1), np.uint64).astype(flat.dtype)


# By name; the first once wrote outside an array, since the turn by the mount's yaw is infinite.
ATTACKS: Mapping[str, tuple[Edit, ...]] = {
    "points that overflow as they are turned": tuple(
        Edit("points", RAYS_FOLLOWED // 3 * 3 + axis, 512, 3, value) for axis, value in enumerate((3e38, -3e38, 5.0))
    ),
    "one point that overflows": tuple(
        Edit("points", RAYS_FOLLOWED // 3 * 3 + axis, 1, 1, value) for axis, value in enumerate((3e38, -3e38, 5.0))
    ),
    "half of the points 1e30": (Edit("points", 0, ALL, 1, 1e30),),
    "half of the points infinite": (Edit("points", 0, ALL, 1, -math.inf),),
    "half of the points NaN": (Edit("points", 0, ALL, 1, math.nan),),
    "heights below what a number holds": (Edit("points", 2, ALL, 3, 1e-45),),
    "points just in reach": (Edit("points", 0, 256, 31, 999.9),),
    "one position 1e300": (Edit("positions_m", 15, 1, 1, 1e300),),
    "one position 1e9": (Edit("positions_m", 15, 1, 1, 1e9),),
    "every position 1e9": (Edit("positions_m", 0, ALL, 1, 1e9),),
    "every position 1e300": (Edit("positions_m", 0, ALL, 1, 1e300),),
    "every position below what a number holds": (Edit("positions_m", 0, ALL, 1, 5e-324),),
    "poses that go 1.5 km away and come back": (Edit("positions_m", 18, 32, 1, -1000.0),),
    "poses that go 100 km away and come back": (Edit("positions_m", 18, 32, 1, -99_000.0),),
    "one quaternion of zeros": (Edit("turns_xyzw", 16, 4, 1, 0.0),),
    "every quaternion of zeros": (Edit("turns_xyzw", 0, ALL, 1, 0.0),),
    "quaternions of 1e300": (Edit("turns_xyzw", 0, ALL, 1, 1e300),),
    "quaternions of 5e-324": (Edit("turns_xyzw", 0, ALL, 1, 5e-324),),
    "one quaternion NaN": (Edit("turns_xyzw", 16, 1, 1, math.nan),),
    "cloud stamps at the beginning of time": (Edit("cloud_sec", 0, ALL, 1, -(2**31)),),
    "one cloud stamp at the end of time": (Edit("cloud_sec", 3, 1, 1, 2**31 - 1),),
    "one cloud of four seconds' nanoseconds": (Edit("cloud_nanosec", 3, 1, 1, 2**32 - 1),),
    "pose stamps at both ends": (Edit("pose_sec", 0, 1, 1, -(2**31)), Edit("pose_sec", 19, 1, 1, 2**31 - 1)),
    "recorded at both ends": (Edit("cloud_log_ns", 0, 4, 1, 0), Edit("pose_log_ns", 0, ALL, 1, 2**64 - 1)),
    "recorded beyond int64": (Edit("cloud_log_ns", 0, ALL, 1, 2**63),),
    "point times NaN": (Edit("times_s", 0, ALL, 1, math.nan),),
    "point times at the end of int64": (Edit("times_s", 0, ALL, 3, 9.3e18),),
    "point times of 1e300": (Edit("times_s", 0, ALL, 1, 1e300),),
    "one point a second early": (Edit("times_s", 0, 1, 1, START_S - 0.9),),
    "rings of 65535": (Edit("rings", 0, ALL, 1, 2**16 - 1),),
    "clouds of 4 billion points": (Edit("sizes", 0, ALL, 5, 2**32 - 1),),
    "a cloud of no rows": (Edit("sizes", 5, 1, 1, 0),),
    "a point of no bytes": (Edit("sizes", 2, 1, 1, 0),),
    "a point of half a cloud": (Edit("sizes", 2, 1, 1, 2**16 - 1),),
    "a mount beyond the map": (Edit("mount_m", 0, 1, 1, 1e300),),
    "a mount at the end of its limit": (Edit("mount_m", 0, 4, 1, 99.9),),
    "a mount turned by nothing": (Edit("mount_wxyz", 0, 4, 1, 0.0),),
    "a mount turned by infinity": (Edit("mount_wxyz", 0, 1, 1, math.inf),),
    "a footprint without end": (Edit("footprint_m", 0, 2, 1, math.inf),),
    "a footprint of 50 m": (Edit("footprint_m", 0, 2, 1, 49.0),),
    "a negative footprint": (Edit("footprint_m", 0, 2, 1, -1.0),),
    "a robot around all of its points": (Edit("boxes_m", 0, 2, 1, -1e300), Edit("boxes_m", 3, 2, 1, 1e300)),
}


def sound_drive() -> Arrays:
    """Return the recorded values without an attack."""
    frames, poses = np.arange(FRAMES), np.arange(POSES)
    world_from_ego = _world_from_ego(poses * POSE_NS)
    points = np.stack([_ground_seen(frame * SWEEP_NS) for frame in range(FRAMES)])
    count = points.shape[1]
    shape = np.array([count, 1, POINT.itemsize, count * POINT.itemsize], np.uint32)
    stamps_ns = SWEEP_NS * (1 + frames)
    return {
        "points": points,
        "times_s": np.linspace(0, 0.09, count) + (START_S + stamps_ns * 1e-9)[:, None],
        "rings": np.tile(np.arange(count) % 16, (FRAMES, 1)).astype(np.uint16),
        "sizes": np.tile(shape, (FRAMES, 1)),
        **_stamps("cloud", stamps_ns, SWEEP_NS),
        **_stamps("pose", poses * POSE_NS, 0),
        "positions_m": world_from_ego.translation_m.copy(),
        "turns_xyzw": np.roll(world_from_ego.wxyz, -1, axis=-1),
        "mount_m": _ego_from_lidar().translation_m.copy(),
        "mount_wxyz": _ego_from_lidar().wxyz.copy(),
        "footprint_m": np.array([1.2, 0.8]),
        "boxes_m": np.array([-0.6, -0.4, 0.0, 0.6, 0.4, 1.0]),
    }


def edits_in(content: bytes) -> Iterator[Edit]:
    """Yield any bytes as edits, `EDIT.size` each; a remainder is ignored."""
    drive = sound_drive()
    names = sorted(drive)
    for name, first, span, chosen, raw in EDIT.iter_unpack(content[: len(content) // EDIT.size * EDIT.size]):
        array = names[name % len(names)]
        is_float = drive[array].dtype.kind == "f"
        values = FLOATS if is_float else INTEGERS
        any_value = struct.unpack("<d", struct.pack("<Q", raw))[0] if is_float else raw
        value = values[chosen] if chosen < len(values) else any_value
        yield Edit(array, first, 1 << span % 16, 1 + 2 * (span >> 4), value)


def edit_bytes(*edits: Edit) -> bytes:
    """Return the bytes of these edits; counts must be powers of two up to 2^15, steps odd and below 32."""
    names = sorted(sound_drive())
    return b"".join(EDIT.pack(names.index(edit.array), edit.first, *_spanned(edit), ANY, _raw(edit)) for edit in edits)


def attacked(*edits: Edit) -> Arrays:
    """Return the sound drive with these edits."""
    arrays = sound_drive()
    for edit in edits:
        edit.apply(arrays)
    return arrays


def write_drive(arrays: Arrays, folder: Path) -> tuple[Path, Path]:
    """Write the recording, and the calibration beside it; return both paths."""
    bag, calibration = folder / "run.mcap", folder / "run.calibration.yaml"
    with bag.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2", library="stone")
        for topic, kind, messages in (("/points", CLOUD, _clouds(arrays)), ("/odom", ODOMETRY, _odometry(arrays))):
            schema = writer.register_schema(kind, "ros2msg", message_definition(kind).encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for log_ns, message in messages:
                writer.add_message(channel, log_ns, bytes(typestore().serialize_cdr(message, kind)), log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    calibration.write_text(_calibration_text(arrays))
    return bag, calibration


def _spanned(edit: Edit) -> tuple[int]:
    return ((edit.step - 1) // 2 << 4 | edit.count.bit_length() - 1,)


def _raw(edit: Edit) -> int:
    """Return the value's bits."""
    if isinstance(edit.value, float):
        return int(struct.unpack("<Q", struct.pack("<d", edit.value))[0])
    return edit.value & (2**64 - 1)


def _world_from_ego(after_ns: NDArray[np.int64]) -> SE3:
    wxyz = np.roll(Rotation.from_euler("ZYX", [0.1, 0.03, 0.02]).as_quat(), 1)
    ahead_m = np.asarray(after_ns) / SWEEP_NS * STEP_M
    return SE3.from_parts(wxyz, np.array(FIRST_M) + ahead_m[..., None] * np.array([1.0, 0.1, 0.0]))


def _ego_from_lidar() -> SE3:
    return SE3.from_parts(np.array([np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)]), np.array([0.2, 0.0, HEIGHT_M]))


def _ground_seen(after_ns: int) -> NDArray[np.float32]:
    """Return the ground around the robot in the LiDAR frame: the ego frame's own plane, another lattice each sweep."""
    line = np.arange(-REACH_M, REACH_M, SPACING_M) + 0.05 * np.sin(after_ns)
    plan = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    ground = np.column_stack([plan, np.zeros(len(plan))])
    return np.asarray(_ego_from_lidar().inverse() @ ground, np.float32)


def _stamps(name: str, after_ns: NDArray[np.int64], late_ns: int) -> Arrays:
    return {
        f"{name}_sec": (START_S + after_ns // 10**9).astype(np.int32),
        f"{name}_nanosec": (after_ns % 10**9).astype(np.uint32),
        f"{name}_log_ns": (START_S * 10**9 + after_ns + late_ns).astype(np.uint64),
    }


def _header(arrays: Arrays, name: str, row: int, frame_id: str) -> Any:
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](int(arrays[f"{name}_sec"][row]), int(arrays[f"{name}_nanosec"][row]))
    return types["std_msgs/msg/Header"](stamp, frame_id)


def _clouds(arrays: Arrays) -> Iterator[tuple[int, Any]]:
    types = typestore().types
    fields = [
        types["sensor_msgs/msg/PointField"](name, POINT.fields[name][1], DATATYPES[POINT[name].str[1:]], 1)  # type: ignore[index]
        for name in POINT.names or ()
    ]
    for row, log_ns in enumerate(arrays["cloud_log_ns"].tolist()):
        points = np.zeros(arrays["points"].shape[1], POINT)
        points["x"], points["y"], points["z"] = arrays["points"][row].T
        points["ring"], points["timestamp"] = arrays["rings"][row], arrays["times_s"][row]
        width, height, point_step, row_step = map(int, arrays["sizes"][row])
        data = np.frombuffer(points.tobytes(), np.uint8)
        head = _header(arrays, "cloud", row, "lidar")
        yield log_ns, types[CLOUD](head, height, width, fields, False, point_step, row_step, data, False)


def _odometry(arrays: Arrays) -> Iterator[tuple[int, Any]]:
    types = typestore().types
    zeros, vector = np.zeros(36), types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = types["geometry_msgs/msg/TwistWithCovariance"](types["geometry_msgs/msg/Twist"](vector, vector), zeros)
    for row, log_ns in enumerate(arrays["pose_log_ns"].tolist()):
        position = types["geometry_msgs/msg/Point"](*arrays["positions_m"][row].tolist())
        turn = types["geometry_msgs/msg/Quaternion"](*arrays["turns_xyzw"][row].tolist())
        pose = types["geometry_msgs/msg/PoseWithCovariance"](types["geometry_msgs/msg/Pose"](position, turn), zeros)
        yield log_ns, types[ODOMETRY](_header(arrays, "pose", row, "odom"), "base_link", pose, twist)


def _calibration_text(arrays: Arrays) -> str:
    """Return JSON, which is YAML, with non-finite numbers as YAML writes them."""
    length_m, width_m = arrays["footprint_m"].tolist()
    boxes = arrays["boxes_m"].reshape(2, 3).tolist()
    record = {
        "stone_calibration": 1,
        "name": "hostile",
        "footprint": {"length_m": length_m, "width_m": width_m},
        "self_boxes_ego": [{"min_m": boxes[0], "max_m": boxes[1]}],
        "ego_from_lidar": {
            "translation_m": arrays["mount_m"].tolist(),
            "rotation_wxyz": arrays["mount_wxyz"].tolist(),
        },
        "sensors": {},
    }
    return json.dumps(record).replace("-Infinity", "-.inf").replace("Infinity", ".inf").replace("NaN", ".nan")
