"""Pictures with separate brightness and colour (YUV), as red, green and blue.

    R = y + 1.596 v   G = y − 0.392 u − 0.813 v   B = y + 2.017 u   y = 1.164 (Y − 16), u = U − 128, v = V − 128

**Conventions.** Eight bits per sample, ITU-R BT.601 of limited range (Y 16 to 235), as in cv_bridge. Two pixels of a
row share a colour in 4:2:2, four of a square in 4:2:0, none in 4:4:4. The last pixel of an odd row or column has a
colour alone. In planar formats, rows of U and V (or V and U) alternate after the rows of Y. Source: sensor_msgs
image_encodings, V4L2 pixel formats (YUYV, UYVY, NV12, NV21, NV24), ITU-R BT.601-7, 2.5.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# In 65536ths: 255/219 of brightness; 255/224 of 1.402, 1.772 and what is left of them for green.
_SHIFT = 16
_Y, _RED, _BLUE = 76309, 104597, 132201
_GREEN_U, _GREEN_V = 25675, 53279
BAND_ROWS = 128

Bytes = NDArray[np.uint8]


class _Packed(NamedTuple):
    """The positions of the first brightness and of U and V in four bytes."""

    luma: int
    u: int
    v: int


class _Planar(NamedTuple):
    """The number of columns and rows that share a colour, and whether V is first."""

    across: int
    down: int
    is_v_first: bool


_PACKED = {name: _Packed(0, 1, 3) for name in ("yuv422_yuy2", "yuyv")}
_PACKED |= {name: _Packed(1, 0, 2) for name in ("yuv422", "uyvy")}
_PLANAR = {"nv12": _Planar(2, 2, False), "nv21": _Planar(2, 2, True), "nv24": _Planar(1, 1, False)}
ENCODINGS = frozenset({*_PACKED, *_PLANAR})


def row_bytes(encoding: str, width_px: int) -> int:
    """Return the least length of a row."""
    return 4 * _half(width_px) if encoding in _PACKED else width_px + width_px % _PLANAR[encoding].across


def rows_of(encoding: str, height_px: int) -> int:
    """Return the number of rows of a picture, including those of U and V after the others, for any encoding."""
    planar = _PLANAR.get(encoding)
    if planar is None:
        return height_px
    return height_px + (_half(height_px) if planar.down == 2 else 2 * height_px)


def yuv_pixels(data: memoryview, encoding: str, size_px: tuple[int, int], step_bytes: int) -> Bytes:
    """Return (H, W, 3) red, green and blue of a picture of this (width, height) with a checked size."""
    width, height = size_px
    rows = np.ndarray((rows_of(encoding, height), step_bytes), np.uint8, data)
    picture = np.empty((height, width, 3), np.uint8)
    for begin in range(0, height, BAND_ROWS):
        band = slice(begin, min(begin + BAND_ROWS, height))
        planes = _packed(rows, encoding, band, width) if encoding in _PACKED else _planar(rows, encoding, band, size_px)
        picture[band] = _rgb(*planes)
    return picture


def _packed(rows: Bytes, encoding: str, band: slice, width: int) -> tuple[Bytes, Bytes, Bytes]:
    at, used = _PACKED[encoding], rows[band, : 4 * _half(width)]
    u, v = (np.repeat(used[:, first::4], 2, axis=1)[:, :width] for first in (at.u, at.v))
    return used[:, at.luma :: 2][:, :width], u, v


def _planar(rows: Bytes, encoding: str, band: slice, size_px: tuple[int, int]) -> tuple[Bytes, Bytes, Bytes]:
    planar, (width, height) = _PLANAR[encoding], size_px
    across = -(-width // planar.across)
    # Rows of colour lie end to end; those of 4:4:4 are two rows of Y long.
    row = rows.shape[1] * (1 if planar.down == 2 else 2)
    behind = rows[height:].reshape(-1, row)
    used = behind[band.start // planar.down : -(-band.stop // planar.down), : 2 * across]
    spread = np.repeat(np.repeat(used.reshape(len(used), across, 2), planar.down, axis=0), planar.across, axis=1)
    spread = spread[: band.stop - band.start, :width]
    first, second = spread[..., 0], spread[..., 1]
    luma = rows[band, :width]
    return (luma, second, first) if planar.is_v_first else (luma, first, second)


def _rgb(luma: Bytes, u: Bytes, v: Bytes) -> Bytes:
    bright = np.maximum(luma.astype(np.int32) - 16, 0) * _Y + (1 << (_SHIFT - 1))
    blue, red = u.astype(np.int32) - 128, v.astype(np.int32) - 128
    channels = (bright + _RED * red, bright - _GREEN_U * blue - _GREEN_V * red, bright + _BLUE * blue)
    return np.stack([(channel >> _SHIFT).clip(0, 255) for channel in channels], axis=-1).astype(np.uint8)


def _half(count: int) -> int:
    return -(-count // 2)
