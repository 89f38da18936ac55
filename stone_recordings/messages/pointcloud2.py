"""sensor_msgs/msg/PointCloud2 as a structured view of its own bytes, checked before it is believed.

**Conventions.** `points` has one record a point, in the order of the message, with the driver's field names; nothing
is copied unless rows are padded or numbers big-endian. Offsets need not be aligned (Hesai: 26 bytes a point). Numbers
leave little-endian. `is_bigendian` is believed unless the places that follow are none and the little-endian ones are:
some drivers set it and write little-endian. Source: sensor_msgs (Humble).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import ByteOrderError, CloudLayoutError, MessageLayoutError
from stone_recordings.messages.lidar import LidarPoints, check_xyz, resolve_points
from stone_recordings.messages.types.cdr import Cursor

__all__ = ["Cloud", "LidarPoints", "decode_cloud", "lidar_points"]

TYPE = "sensor_msgs/msg/PointCloud2"
FORMATS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
# name length, terminator, offset, datatype, count: what a PointField takes at least.
LEAST_FIELD_BYTES = 4 + 1 + 4 + 1 + 4
FIELD_LIMIT = 256
# Coordinates that a LiDAR can report; a number whose bytes are swapped has an exponent like any other.
LEAST_PLACE_M, LAST_PLACE_M = 1e-6, 1e5
LEAST_PLACES = 0.5


class _PointField(NamedTuple):
    name: str
    offset: int
    datatype: int
    length: int


class _CloudLayout(NamedTuple):
    height: int
    width: int
    fields: tuple[_PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data_bytes: int


@dataclass(frozen=True, eq=False)
class Cloud:
    """One message: stamp, frame and N point records; `is_misdeclared` where its byte order is not the declared one."""

    stamp_ns: int
    frame_id: str
    points: NDArray[np.void]
    is_misdeclared: bool = False


def decode_cloud(payload: memoryview) -> Cloud:
    """The cloud as a view of `payload`, or a copy of one that is big-endian.

    Raises: MessageLayoutError, ByteOrderError (of the CDR), CloudLayoutError (a field beyond point_step, steps or data
    that contradict the size of the cloud).
    """
    cursor = Cursor(payload, TYPE)
    stamp_ns, frame_id = cursor.stamp_ns(), cursor.text()
    layout = _layout(cursor)
    start = cursor.take(cursor.bounded(layout.data_bytes, 1))
    record = record_of(layout.fields, layout.point_step)
    _check_steps(layout)
    steps = (layout.row_step, layout.point_step)
    points = np.ndarray((layout.height, layout.width), record, payload, start, steps).reshape(-1)
    if not layout.is_bigendian:
        return Cloud(stamp_ns, frame_id, points)
    swapped = points.view(record.newbyteorder(">")).astype(record)
    is_misdeclared = _places_ratio(swapped) < LEAST_PLACES <= _places_ratio(points)
    return Cloud(stamp_ns, frame_id, points if is_misdeclared else swapped, is_misdeclared)


def _places_ratio(points: NDArray[np.void]) -> float:
    """How many of the finite coordinates can be a sensor's; 1 where there are none."""
    names = [name for name in "xyz" if name in (points.dtype.names or ()) and points.dtype[name].kind == "f"]
    with np.errstate(invalid="ignore"):  # a swapped number may be a NaN that signals
        values = np.abs(np.array([points[name].astype(np.float64) for name in names]))
    values = values[np.isfinite(values)]
    is_place = (values == 0) | ((values >= LEAST_PLACE_M) & (values <= LAST_PLACE_M))
    return float(is_place.mean()) if len(values) else 1.0


def layout_problem(head: memoryview, size_bytes: Callable[[], int]) -> str:
    """Why a cloud that begins so cannot be decoded; "" where nothing speaks against it.

    The first bytes tell, up to where the points begin; `size_bytes` is the size of the whole message, asked for only
    where the head does not reach as far as its points.
    """
    try:
        cursor = Cursor(head, TYPE)
        cursor.stamp_ns()
        cursor.text()
        layout = _layout(cursor)
        record_of(layout.fields, layout.point_step)
        _check_steps(layout)
    except (ByteOrderError, CloudLayoutError, MessageLayoutError) as error:
        return str(error)
    end = cursor.at + layout.data_bytes
    if end > len(head) and end > (size := size_bytes()):
        return str(MessageLayoutError(TYPE, f"its points end at byte {end}, the message has {size}"))
    return ""


def xyz_problem(head: memoryview) -> str:
    """Why a cloud that begins so, and can be decoded, holds no points in space; "" where it does."""
    cursor = Cursor(head, TYPE)
    cursor.stamp_ns()
    cursor.text()
    layout = _layout(cursor)
    try:
        check_xyz(record_of(layout.fields, layout.point_step))
    except CloudLayoutError as error:
        return str(error)
    return ""


def _layout(cursor: Cursor) -> _CloudLayout:
    """What stands between the header and the points."""
    height, width = cursor.u32(), cursor.u32()
    count = cursor.count(LEAST_FIELD_BYTES)
    if count > FIELD_LIMIT:
        raise CloudLayoutError(f"{count} fields are declared, the limit is {FIELD_LIMIT}")
    fields = tuple(_PointField(cursor.text(), cursor.u32(), cursor.u8(), cursor.u32()) for _ in range(count))
    is_bigendian = cursor.u8() != 0
    point_step, row_step = cursor.u32(), cursor.u32()
    return _CloudLayout(height, width, fields, is_bigendian, point_step, row_step, cursor.u32())


def lidar_points(cloud: Cloud, *, with_ring: bool = True) -> LidarPoints:
    """Finite, non-zero points with their time and, unless spared, ring; see `stone_recordings.messages.lidar`."""
    return resolve_points(cloud.points, cloud.stamp_ns, with_ring=with_ring)


@lru_cache(maxsize=64)
def record_of(fields: tuple[_PointField, ...], point_step: int) -> np.dtype[np.void]:
    """The numpy record of a point; fields named "" or "_…" are padding. Raises: CloudLayoutError."""
    named = [field for field in fields if field.name.strip("_")]
    if len({field.name for field in named}) != len(named):
        raise CloudLayoutError(f"a field is declared twice: {', '.join(field.name for field in named)}"[:200])
    formats: list[str] = []
    for field in named:
        if field.datatype not in FORMATS:
            raise CloudLayoutError(f"field {field.name!r} has datatype {field.datatype}, known are 1 to 8")
        code, count = FORMATS[field.datatype], max(1, field.length)
        end = field.offset + np.dtype(code).itemsize * count
        if end > point_step:
            raise CloudLayoutError(f"field {field.name!r} ends at byte {end}, point_step is {point_step}")
        formats.append(code if count == 1 else f"{count}{code}")
    if point_step == 0 or point_step > 1 << 16:
        raise CloudLayoutError(f"point_step is {point_step}, expected 1 to {1 << 16}")
    names, offsets = [field.name for field in named], [field.offset for field in named]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step})


def _check_steps(layout: _CloudLayout) -> None:
    height, width, point_step, row_step = layout.height, layout.width, layout.point_step, layout.row_step
    if row_step < width * point_step:
        problem = f"row_step {row_step} holds no {width} points of {point_step} bytes ({width * point_step})"
        raise CloudLayoutError(problem)
    if layout.data_bytes != height * row_step:
        problem = f"{height} rows of {row_step} bytes are {height * row_step}, data has {layout.data_bytes}"
        raise CloudLayoutError(problem)
