"""The header of a JPEG or PNG: kind and size, read before any decoding.

**Conventions.** Sizes are (width, height) pixels. Source: ITU-T T.81 annex B (markers), PNG specification 1.2, 4.1.1.
"""

from typing import Literal, NamedTuple

from stone_recordings.messages.errors import PictureError

# Twice the largest sensor that the camera's driver supports (24 MP): what is larger is no picture but an attack.
MOST_PIXELS = 48_000_000
# A progressive JPEG has about ten scans; each costs a walk over the whole picture, however few bytes it takes.
MOST_SCANS = 100
JPEG_MAGIC, PNG_MAGIC = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
# Start of frame, without the tables that share its range of markers (DHT, JPG, DAC).
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_ALONE_MARKERS = frozenset({0x01, *range(0xD0, 0xD9)})
_SCAN = 0xDA


class PictureHeader(NamedTuple):
    kind: Literal["JPEG", "PNG"]
    width_px: int
    height_px: int


def head_of(data: bytes, type_name: str) -> PictureHeader:
    """Kind and declared size. Raises: PictureError (neither JPEG nor PNG, cut off, no size, larger than the limit)."""
    if data.startswith(JPEG_MAGIC):
        head = _jpeg(data, type_name)
    elif data.startswith(PNG_MAGIC):
        head = _png(data, type_name)
    else:
        raise PictureError(type_name, f"first bytes {data[:8].hex(' ')} are neither JPEG nor PNG")
    check_size(head.width_px, head.height_px, type_name)
    return head


def check_size(width_px: int, height_px: int, type_name: str) -> None:
    if width_px < 1 or height_px < 1:
        raise PictureError(type_name, f"it is {width_px} × {height_px} pixels")
    if width_px * height_px > MOST_PIXELS:
        raise PictureError(type_name, f"it declares {width_px} × {height_px} pixels, the limit is {MOST_PIXELS}")


def _png(data: bytes, type_name: str) -> PictureHeader:
    if data[12:16] != b"IHDR" or len(data) < 24:
        raise PictureError(type_name, "the PNG does not begin with its header")
    return PictureHeader("PNG", int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big"))


def _jpeg(data: bytes, type_name: str) -> PictureHeader:
    """Walk the segments up to the frame header; only lengths are believed, and those are checked."""
    scans = data.count(b"\xff\xda")
    if scans > MOST_SCANS:
        raise PictureError(type_name, f"the JPEG has {scans} scans, the limit is {MOST_SCANS}")
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise PictureError(type_name, f"byte {at} of the JPEG is not a marker")
        marker = data[at + 1]
        if marker == 0xFF or marker in _ALONE_MARKERS:
            at += 1 if marker == 0xFF else 2
            continue
        if marker in _FRAME_MARKERS and at + 9 <= len(data):
            return PictureHeader(
                "JPEG", int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7])
            )
        if marker == _SCAN:
            break
        at += 2 + max(2, int.from_bytes(data[at + 2 : at + 4], "big"))
    raise PictureError(type_name, "the JPEG ends before it says its size")
