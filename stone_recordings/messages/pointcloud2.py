"""sensor_msgs/msg/PointCloud2 as a structured view of its own bytes, checked before use.

If a cloud's declarations contradict each other, its bytes decide: rows, sizes and steps that the length of the data
refutes are ignored and named in `Cloud.ignored`. A cloud is refused only if its bytes are ambiguous.

**Conventions.** `points` has one record per point, in the order of the message, with the driver's field names; nothing
is copied unless rows are padded or numbers big-endian. Offsets need not be aligned (Hesai: 26 bytes per point). Numbers
leave little-endian. `is_bigendian` is ignored if it gives impossible positions and little-endian possible ones: some
drivers set it and write little-endian. The first field of a name counts. Source: sensor_msgs (Humble).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import ByteOrderError, CloudLayoutError, MessageLayoutError
from stone_recordings.messages.lidar import LidarPoints, check_xyz, resolve_points
from stone_recordings.messages.point_times import PointClock
from stone_recordings.messages.types.cdr import Cursor

__all__ = ["Cloud", "LidarPoints", "decode_cloud", "lidar_points"]

TYPE = "sensor_msgs/msg/PointCloud2"
FORMATS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
# The least size of a PointField: name length, terminator, offset, datatype, count.
LEAST_FIELD_BYTES = 4 + 1 + 4 + 1 + 4
FIELD_LIMIT, MOST_STEP_BYTES = 256, 1 << 16
PLACE_NAMES = frozenset("xyz")
# Coordinates that a LiDAR can report; a number with swapped bytes can have any exponent.
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


class CloudSize(NamedTuple):
    """The declared number of points, the bytes of the points and of their rows, and the bytes that follow."""

    points: int
    points_bytes: int
    rows_bytes: int
    data_bytes: int


@dataclass(frozen=True, eq=False)
class Cloud:
    """One message: stamp, frame and N point records; `is_misdeclared` if its byte order is not the declared one.

    `ignored` names the declarations that its bytes contradict, with their values; "" without any.
    """

    stamp_ns: int
    frame_id: str
    points: NDArray[np.void]
    is_misdeclared: bool = False
    ignored: str = ""


class _Rows(NamedTuple):
    """The layout of the points: `height` rows of `width` points, as the bytes decide; `ignored` as in a Cloud."""

    height: int
    width: int
    record: np.dtype[np.void]
    row_step: int
    ignored: str


def decode_cloud(payload: memoryview) -> Cloud:
    """Return the cloud as a view of `payload`, or as a copy if it is big-endian.

    Raises: MessageLayoutError, ByteOrderError (of the CDR), CloudLayoutError (a field beyond point_step, steps or data
    that contradict the size of the cloud).
    """
    cursor = Cursor(payload, TYPE)
    stamp_ns, frame_id = cursor.stamp_ns(), cursor.text()
    layout = _layout(cursor)
    start = cursor.take(cursor.bounded(layout.data_bytes, 1))
    rows = _rows(layout)
    record, steps = rows.record, (rows.row_step, rows.record.itemsize)
    points = np.ndarray((rows.height, rows.width), record, payload, start, steps).reshape(-1)
    if not layout.is_bigendian:
        return Cloud(stamp_ns, frame_id, points, ignored=rows.ignored)
    swapped = points.view(record.newbyteorder(">")).astype(record)
    is_misdeclared = _places_ratio(swapped) < LEAST_PLACES <= _places_ratio(points)
    return Cloud(stamp_ns, frame_id, points if is_misdeclared else swapped, is_misdeclared, rows.ignored)


def _places_ratio(points: NDArray[np.void]) -> float:
    """Return the share of finite coordinates that a sensor can measure; 1 without coordinates."""
    names = [name for name in "xyz" if name in (points.dtype.names or ()) and points.dtype[name].kind == "f"]
    with np.errstate(invalid="ignore"):  # a swapped number may be a signalling NaN
        values = np.abs(np.array([points[name].astype(np.float64) for name in names]))
    values = values[np.isfinite(values)]
    is_place = (values == 0) | ((values >= LEAST_PLACE_M) & (values <= LAST_PLACE_M))
    return float(is_place.mean()) if len(values) else 1.0


def layout_problem(head: memoryview, size_bytes: Callable[[], int]) -> str:
    """Return why a cloud with this head cannot be decoded; "" if the head is valid.

    The first bytes up to the points decide; `size_bytes`, the size of the whole message, is called only if the head
    does not reach its points.
    """
    try:
        cursor = Cursor(head, TYPE)
        cursor.stamp_ns()
        cursor.text()
        layout = _layout(cursor)
        _rows(layout)
    except (ByteOrderError, CloudLayoutError, MessageLayoutError) as error:
        return str(error)
    end = cursor.at + layout.data_bytes
    if end > len(head) and end > (size := size_bytes()):
        return str(MessageLayoutError(TYPE, f"its points end at byte {end}, the message has {size}"))
    return ""


def xyz_problem(head: memoryview, *, is_compressed: bool = False) -> str:
    """Return why a decodable cloud with this head holds no points in space; "" if it does.

    The length of the data of a compressed cloud decides nothing.
    """
    cursor = Cursor(head, TYPE)
    cursor.stamp_ns()
    cursor.text()
    layout = _layout(cursor)
    try:
        check_xyz(record_of(layout.fields, layout.point_step)[0] if is_compressed else _rows(layout).record)
    except CloudLayoutError as error:
        return str(error)
    return ""


def points_of_head(head: memoryview) -> int:
    """Return the number of points of a cloud with this head. Raises the errors of `decode_cloud`."""
    cursor = Cursor(head, TYPE)
    cursor.stamp_ns()
    cursor.text()
    rows = _rows(_layout(cursor))
    return rows.height * rows.width


def cloud_size(cursor: Cursor) -> CloudSize:
    """Return the declared size after the header, at the cursor. Raises: CloudLayoutError (its fields)."""
    layout = _layout(cursor)
    record_of(layout.fields, layout.point_step)
    points = layout.height * layout.width
    return CloudSize(points, points * layout.point_step, layout.height * layout.row_step, layout.data_bytes)


def _layout(cursor: Cursor) -> _CloudLayout:
    """Return the layout between the header and the points."""
    height, width = cursor.u32(), cursor.u32()
    count = cursor.count(LEAST_FIELD_BYTES)
    if count > FIELD_LIMIT:
        raise CloudLayoutError(f"{count} fields are declared, the limit is {FIELD_LIMIT}")
    fields = tuple(_PointField(cursor.text(), cursor.u32(), cursor.u8(), cursor.u32()) for _ in range(count))
    is_bigendian = cursor.u8() != 0
    point_step, row_step = cursor.u32(), cursor.u32()
    return _CloudLayout(height, width, fields, is_bigendian, point_step, row_step, cursor.u32())


def lidar_points(cloud: Cloud, *, with_ring: bool = True, clock: PointClock | None = None) -> LidarPoints:
    """Return finite, non-zero points with their time and, by default, ring; see `stone_recordings.messages.lidar`."""
    return resolve_points(cloud.points, cloud.stamp_ns, with_ring=with_ring, clock=clock)


@lru_cache(maxsize=64)
def record_of(fields: tuple[_PointField, ...], point_step: int) -> tuple[np.dtype[np.void], str]:
    """Return the numpy record of a point, and the ignored fields; fields named "" or "_…" are padding.

    A field that no bytes can hold is ignored unless it is a coordinate. Raises: CloudLayoutError.
    """
    kept: dict[str, _PointField] = {}
    ignored = list[str]()
    for field in fields:
        if not field.name.strip("_"):
            continue
        problem = _field_problem(field, point_step)
        if problem and field.name in PLACE_NAMES and field.name not in kept:
            raise CloudLayoutError(problem)
        if problem or field.name in kept:
            ignored.append(problem or f"a second field {field.name!r}")
        else:
            kept[field.name] = field
    if point_step == 0 or point_step > MOST_STEP_BYTES:
        raise CloudLayoutError(f"point_step is {point_step}, expected 1 to {MOST_STEP_BYTES}")
    counts = [max(1, field.length) for field in kept.values()]
    codes = [FORMATS[field.datatype] for field in kept.values()]
    formats = [code if count == 1 else f"{count}{code}" for code, count in zip(codes, counts, strict=True)]
    offsets = [field.offset for field in kept.values()]
    record = np.dtype({"names": list(kept), "formats": formats, "offsets": offsets, "itemsize": point_step})
    return record, "; ".join(ignored)


def _field_problem(field: _PointField, point_step: int) -> str:
    if field.datatype not in FORMATS:
        return f"field {field.name!r} has datatype {field.datatype}, known are 1 to 8"
    end = _end_of(field)
    return f"field {field.name!r} ends at byte {end}, point_step is {point_step}" if end > point_step else ""


def _end_of(field: _PointField) -> int:
    return field.offset + np.dtype(FORMATS[field.datatype]).itemsize * max(1, field.length)


def _rows(layout: _CloudLayout) -> _Rows:
    """Return the rows that fit the length of the data. Raises: CloudLayoutError."""
    height, width, row_step, data_bytes = layout.height, layout.width, layout.row_step, layout.data_bytes
    step = _point_step(layout)
    record, ignored = record_of(layout.fields, step)
    wrong = [f"point_step {layout.point_step}"] * (step != layout.point_step)
    # No row is padded by whole points, or empty: its width is wrong then.
    is_padded = row_step > width * step > 0 and row_step % step > 0
    is_of_rows = height * row_step == data_bytes and (row_step == width * step or is_padded)
    is_of_points = data_bytes % step == 0 and data_bytes > 0 and height <= 1
    if is_of_rows:
        pass
    elif height * width * step == data_bytes:
        wrong, row_step = [*wrong, f"row_step {row_step}"], width * step
    elif is_of_points:
        is_row_wrong = row_step != data_bytes
        wrong += [f"height {height}"] * (height != 1) + [f"width {width}"] + [f"row_step {row_step}"] * is_row_wrong
        height, width, row_step = 1, data_bytes // step, data_bytes
    elif height and height * row_step == data_bytes and row_step % step == 0:
        wrong, width = [*wrong, f"width {width}"], row_step // step
    elif row_step and row_step == width * step and data_bytes and data_bytes % row_step == 0:
        wrong, height = [*wrong, f"height {height}"], data_bytes // row_step
    else:
        raise CloudLayoutError(
            f"{height} rows of {width} points of {step} bytes are {height * width * step}, or {height * row_step} by "
            f"row_step {row_step}; data has {data_bytes}"
        )
    contradiction = f"{', '.join(wrong)} against {data_bytes} bytes of data" if wrong else ""
    return _Rows(
        height, width, record, row_step, "; ".join(sentence for sentence in (contradiction, ignored) if sentence)
    )


def _point_step(layout: _CloudLayout) -> int:
    """Return the declared step, unless both the rows and the data imply another size of a point.

    A larger size that holds every field means more points, not a larger step.
    """
    points, step = layout.height * layout.width, layout.point_step
    ends = {item.name: _end_of(item) for item in layout.fields if item.datatype in FORMATS}
    least = max((end for name, end in ends.items() if name in PLACE_NAMES), default=1)
    if not points or points * step == layout.data_bytes or layout.data_bytes % points:
        return step
    implied = layout.data_bytes // points
    if step >= max(ends.values(), default=1) and implied > step and layout.data_bytes % step == 0:
        return step
    is_told = step < least or layout.row_step == layout.width * implied
    return implied if least <= implied <= MOST_STEP_BYTES and is_told else step
