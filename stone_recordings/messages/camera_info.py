"""sensor_msgs/msg/CameraInfo: the calibration that a camera's driver publishes, each version once.

**Conventions.** Pixels before binning and region of interest are applied, as in ROS; matrices are row by row. A camera
whose `k` starts with 0 is uncalibrated. Source: sensor_msgs (Humble).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.table import MessageTable, decode_table

TYPE = "sensor_msgs/msg/CameraInfo"


@dataclass(frozen=True, eq=False)
class CameraInfo:
    """`distortion` has the length that `model` requires; `roi_px` is x, y, width, height, zeros for the whole image."""

    frame_id: str
    width_px: int
    height_px: int
    model: str
    distortion: NDArray[np.float64]
    k: NDArray[np.float64]
    r: NDArray[np.float64]
    p: NDArray[np.float64]
    binning: tuple[int, int]
    roi_px: tuple[int, int, int, int]

    @property
    def is_calibrated(self) -> bool:
        return bool(self.k[0, 0] != 0)


@dataclass(frozen=True, eq=False)
class CameraInfoSamples:
    """N messages: message i contains `infos[which[i]]`; `infos` are distinct, in the order of their first message."""

    stamps_ns: NDArray[np.int64]
    which: NDArray[np.int64]
    infos: tuple[CameraInfo, ...]


def decode_camera_info(messages: Iterable[StampedMessage], schema: str = "") -> CameraInfoSamples:
    """Decode the messages. Raises: MessageLayoutError, ByteOrderError."""
    table = decode_table(TYPE, messages, resolved(TYPE, schema).registry)
    keys = [_key(table, row) for row in range(table.count)]
    first_rows: dict[tuple[object, ...], int] = {}
    for row, key in enumerate(keys):
        first_rows.setdefault(key, row)
    places = {key: index for index, key in enumerate(first_rows)}
    which = np.array([places[key] for key in keys], np.int64)
    return CameraInfoSamples(table.stamps_ns(), which, tuple(_info(table, row) for row in first_rows.values()))


def _info(table: MessageTable, row: int) -> CameraInfo:
    offsets, distortion = table.ragged("d")
    whole = {name: int(table.numbers(name)[row]) for name in ("width", "height", "binning_x", "binning_y")}
    x, y, width, height = (
        int(table.numbers(f"roi.{name}")[row]) for name in ("x_offset", "y_offset", "width", "height")
    )
    return CameraInfo(
        table.texts("header.frame_id")[row],
        whole["width"],
        whole["height"],
        table.texts("distortion_model")[row],
        distortion[offsets[row] : offsets[row + 1]],
        table.numbers("k", 9)[row].reshape(3, 3),
        table.numbers("r", 9)[row].reshape(3, 3),
        table.numbers("p", 12)[row].reshape(3, 4),
        (whole["binning_x"], whole["binning_y"]),
        (x, y, width, height),
    )


def _key(table: MessageTable, row: int) -> tuple[object, ...]:
    """Return everything but the stamp, bit for bit (a NaN equals itself)."""
    info = _info(table, row)
    arrays = (array.tobytes() for array in (info.distortion, info.k, info.r, info.p))
    sizes = (info.width_px, info.height_px, info.binning, info.roi_px)
    return (info.frame_id, info.model, *sizes, *arrays)
