"""Tiny recordings and messages for the tests, written by other people's libraries.

**Conventions.** Containers are written with `mcap` and `rosbags`, messages serialised with `rosbags`: what our readers
give back is compared with what these wrote.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from stone_recordings.messages.types.registry import message_definition, typestore

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
START_NS = 1_700_000_000_123_456_789
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
HESAI = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "timestamp"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f8"],
        "offsets": [0, 4, 8, 12, 16, 18],
        "itemsize": 26,
    }
)
NEBULA = np.dtype(
    {
        "names": [*"xyz", "intensity", "return_type", "channel", "azimuth", "elevation", "distance", "time_stamp"],
        "formats": ["<f4", "<f4", "<f4", "u1", "u1", "<u2", "<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 12, 13, 14, 16, 20, 24, 28],
        "itemsize": 32,
    }
)
KITTI = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])


@dataclass(frozen=True)
class Recorded:
    """One message to write."""

    topic: str
    type: str
    log_time_ns: int
    payload: bytes


@dataclass(frozen=True)
class CloudText:
    """What a cloud says about itself beside its points; None means the truth."""

    stamp_ns: int = START_NS
    frame_id: str = "hesai_lidar"
    point_step: int | None = None
    row_step: int | None = None
    width: int | None = None
    height: int = 1
    is_bigendian: bool = False
    offset_of_x: int | None = None
    datatype_of_x: int | None = None


def write_mcap(path: Path, messages: Sequence[Recorded], encoding: str = "cdr", **options: Any) -> Path:
    """Write with the `mcap` library; `options` are its Writer's (compression, chunk_size, use_chunking, …)."""
    options.setdefault("compression", CompressionType.NONE)
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="tests")
        channels: dict[str, int] = {}
        for message in messages:
            if message.topic not in channels:
                text = schema_text(message.type)
                schema = writer.register_schema(message.type, "ros2msg", text.encode())
                channels[message.topic] = writer.register_channel(message.topic, encoding, schema)
            time_ns = message.log_time_ns
            writer.add_message(channels[message.topic], time_ns, message.payload, publish_time=time_ns)
        writer.finish()
    return path


def schema_text(type_name: str) -> str:
    return message_definition(type_name) if type_name in typestore().fielddefs else "uint8 nothing"


def serialised(message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def made(type_name: str, **fields: Any) -> Any:
    """A message of rosbags' class for the type."""
    return typestore().types[type_name](**fields)


def header(stamp_ns: int, frame_id: str) -> Any:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return made(
        "std_msgs/msg/Header", stamp=made("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec), frame_id=frame_id
    )


def cloud_payload(points: NDArray[np.void], text: CloudText | None = None) -> bytes:
    """A PointCloud2 of structured points, telling the truth or whatever `text` says."""
    said = text or CloudText()
    fields = [_field(points.dtype, name, said) for name in points.dtype.names or ()]
    step = points.dtype.itemsize if said.point_step is None else said.point_step
    width = len(points) // max(1, said.height) if said.width is None else said.width
    data = np.frombuffer(points.tobytes(), np.uint8)
    message = made(
        POINT_CLOUD,
        header=header(said.stamp_ns, said.frame_id),
        height=said.height,
        width=width,
        fields=fields,
        is_bigendian=said.is_bigendian,
        point_step=step,
        row_step=points.dtype.itemsize * width if said.row_step is None else said.row_step,
        data=data,
        is_dense=False,
    )
    return serialised(message)


def _field(record: np.dtype[np.void], name: str, said: CloudText) -> Any:
    code, offset = (record.fields or {})[name][:2]
    datatype = DATATYPES[code.str[1:]]
    if name == "x":
        offset = offset if said.offset_of_x is None else said.offset_of_x
        datatype = datatype if said.datatype_of_x is None else said.datatype_of_x
    return made("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)


def sweep(record: np.dtype[np.void], count: int, seed: int = 0, stamp_ns: int = START_NS) -> NDArray[np.void]:
    """`count` points of one 100 ms revolution in a driver's layout, no two alike."""
    generator = np.random.default_rng(seed)
    points = np.zeros(count, record)
    for name in "xyz":
        points[name] = generator.normal(0, 20, count)
    offset_ns = (np.arange(count) * 1e8 / max(1, count)).astype(np.int64)
    names = record.names or ()
    if "timestamp" in names:
        points["timestamp"] = (stamp_ns + offset_ns) / 1e9
    if "time_stamp" in names:
        points["time_stamp"] = offset_ns
    for name in {"ring", "channel"} & set(names):
        points[name] = np.arange(count) % 128
    return points


def random_message(
    type_name: str, generator: np.random.Generator, is_tame: bool = False, store: Typestore | None = None
) -> Any:
    """A message whose every field is random bits, NaNs and infinities included; `is_tame`: floats are ordinary, and
    quaternions of norm 1."""
    known = store or typestore()
    _constants, fields = known.fielddefs[type_name]
    values = {name: _random_value(kind, generator, is_tame, known) for name, kind in fields}
    if is_tame and type_name == "geometry_msgs/msg/Quaternion":
        values = {name: value / np.linalg.norm([*values.values()]) for name, value in values.items()}
    return known.types[type_name](**values)


def _random_value(kind: Any, generator: np.random.Generator, is_tame: bool, store: Typestore) -> Any:
    node, detail = kind
    if node == Nodetype.BASE:
        return _random_text(generator) if detail[0] == "string" else _random_array(detail[0], 1, generator, is_tame)[0]
    if node == Nodetype.NAME:
        return random_message(detail, generator, is_tame, store)
    (element, size) = detail
    length = size if node == Nodetype.ARRAY else int(generator.integers(0, 4))
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return _random_array(element[1][0], length, generator, is_tame)
    return [_random_value(element, generator, is_tame, store) for _ in range(length)]


def _random_array(code: str, length: int, generator: np.random.Generator, is_tame: bool) -> Any:
    if code == "byte":  # unsigned in ROS 2, signed to rosbags: what both agree on
        return generator.integers(0, 128, length).astype(np.int8)
    kind = np.dtype("u1" if code in ("octet", "char") else code)
    if kind.kind == "f" and is_tame:
        return generator.normal(0, 10, length).astype(kind)
    if kind.kind == "b":
        return generator.integers(0, 2, length).astype(kind)
    return np.frombuffer(generator.bytes(length * kind.itemsize), kind)


def _random_text(generator: np.random.Generator) -> str:
    return "".join(generator.choice(list("abc_/é"), int(generator.integers(0, 9))))
