"""sensor_msgs Image and CompressedImage → pixels, checked before anything is allocated.

**Conventions.** Pixels are (H, W, 3) uint8, red, green, blue. Sixteen-bit samples keep their upper eight bits. The
first bytes of a compressed image determine its kind; the free text `format` is ignored. Distances (depth images of REP
118) are no pictures. Source: sensor_msgs (Humble), image_encodings.
"""

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from stone_recordings.messages import yuv
from stone_recordings.messages.errors import PictureError
from stone_recordings.messages.types.cdr import Cursor

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_TYPES = frozenset({IMAGE, COMPRESSED})
# Channels, bytes per sample, and the channels that are red, green and blue.
_LAYOUTS: dict[str, tuple[int, int, tuple[int, int, int]]] = {
    "mono8": (1, 1, (0, 0, 0)), "8UC1": (1, 1, (0, 0, 0)), "mono16": (1, 2, (0, 0, 0)),
    "rgb8": (3, 1, (0, 1, 2)), "bgr8": (3, 1, (2, 1, 0)), "8UC3": (3, 1, (2, 1, 0)), "rgb16": (3, 2, (0, 1, 2)),
    "bgr16": (3, 2, (2, 1, 0)), "rgba8": (4, 1, (0, 1, 2)), "bgra8": (4, 1, (2, 1, 0)), "8UC4": (4, 1, (2, 1, 0)),
    "rgba16": (4, 2, (0, 1, 2)), "bgra16": (4, 2, (2, 1, 0)),
}  # fmt: skip
_DEPTH = frozenset({"16UC1", "32FC1", "64FC1"})
_BAYER = {f"bayer_{name}{bits}": (name, bits // 8) for name in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)}


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """One image, not decoded yet; `encoding` is ROS' word for raw images, "JPEG" or "PNG" for compressed ones.

    `step_bytes` is the length of a row, 0 for compressed images; `ignored` lists declarations that its bytes
    contradict.
    """

    type_name: str
    stamp_ns: int
    frame_id: str
    width_px: int
    height_px: int
    encoding: str
    step_bytes: int
    is_bigendian: bool
    data: memoryview
    ignored: str = ""

    def pixels(self, max_width_px: int | None = None) -> NDArray[np.uint8]:
        """Return (H, W, 3) uint8, no wider than `max_width_px`, with the same aspect ratio. Raises: PictureError
        (damaged data).
        """
        if self.step_bytes == 0:
            return _decompressed(self, max_width_px)
        return _narrowed(_raw_pixels(self, max_width_px), max_width_px)


def decode_image(payload: memoryview, type_name: str) -> CameraPicture:
    """Read the head. Raises: MessageLayoutError, ByteOrderError, PictureError (an invalid encoding, size or length)."""
    return _compressed(payload) if type_name == COMPRESSED else _raw(payload)


def picture_problem(head: memoryview, type_name: str, size_bytes: Callable[[], int]) -> str:
    """Return why a picture with this head is invalid; "" if the head is valid, or the type is another.

    `size_bytes` returns the size of the whole message. Only decoding checks the rest.
    """
    if type_name == IMAGE:
        return _raw_problem(head, size_bytes)
    if type_name != COMPRESSED:
        return ""
    cursor = Cursor(head, COMPRESSED)
    for step in (cursor.stamp_ns, cursor.text, cursor.text):
        step()
    end = cursor.u32() + cursor.at
    if end > size_bytes():
        return f"{COMPRESSED}: its picture ends at byte {end}, the message has {size_bytes()}"
    first = bytes(head[cursor.at : min(end, cursor.at + SHOWN_BYTES)])
    if not first.startswith((JPEG_MAGIC, PNG_MAGIC)):
        return str(_no_picture(first, COMPRESSED))
    try:
        if end <= len(head):
            check_end(head[cursor.at : end], COMPRESSED)
    except PictureError as error:
        return str(error)
    return ""


def _raw_problem(head: memoryview, size_bytes: Callable[[], int]) -> str:
    """Return the fault in the fields before the pixels of a raw image, or ""."""
    cursor = Cursor(head, IMAGE)
    cursor.stamp_ns()
    cursor.text()
    height, width, encoding = cursor.u32(), cursor.u32(), cursor.text()
    cursor.u8()
    cursor.u32()
    end = cursor.u32() + cursor.at
    try:
        check_size(width, height, IMAGE)
        _row_bytes(encoding, width)
    except PictureError as error:
        return str(error)
    return "" if end <= size_bytes() else f"{IMAGE}: its pixels end at byte {end}, the message has {size_bytes()}"


def picture_of(type_name: str, payload: memoryview, max_width_px: int | None = None) -> NDArray[np.uint8]:
    """Return (H, W, 3) of one message; a narrow picture is decoded at reduced size, much faster. Raises: as above."""
    return decode_image(payload, type_name).pixels(max_width_px)


def _compressed(payload: memoryview) -> CameraPicture:
    cursor = Cursor(payload, COMPRESSED)
    stamp_ns, frame_id, _format = cursor.stamp_ns(), cursor.text(), cursor.text()
    size = cursor.count(1)
    start = cursor.take(size)
    data = payload[start : start + size]
    head = head_of(bytes(data), COMPRESSED)
    return CameraPicture(COMPRESSED, stamp_ns, frame_id, head.width_px, head.height_px, head.kind, 0, False, data)


def _raw(payload: memoryview) -> CameraPicture:
    cursor = Cursor(payload, IMAGE)
    stamp_ns, frame_id = cursor.stamp_ns(), cursor.text()
    height, width, encoding = cursor.u32(), cursor.u32(), cursor.text()
    is_bigendian, step = cursor.u8() != 0, cursor.u32()
    size = cursor.count(1)
    start = cursor.take(size)
    check_size(width, height, IMAGE)
    row_bytes, rows = _row_bytes(encoding, width), yuv.rows_of(encoding, height)
    ignored = ""
    if size == row_bytes * rows and step != row_bytes:  # rows without padding, whatever `step` is
        step, ignored = row_bytes, f"step {step} against {size} bytes of data"
    if step < row_bytes or size != step * rows:
        raise PictureError(IMAGE, f"{height} rows of {step} bytes do not hold {width} × {height} {encoding} in {size}")
    return CameraPicture(
        IMAGE, stamp_ns, frame_id, width, height, encoding, step, is_bigendian, payload[start : start + size], ignored
    )


def _row_bytes(encoding: str, width: int) -> int:
    """Return the least length of a row. Raises: PictureError (an unsupported encoding)."""
    if encoding in yuv.ENCODINGS:
        return yuv.row_bytes(encoding, width)
    if encoding in _BAYER:
        return width * _BAYER[encoding][1]
    if encoding not in _LAYOUTS:
        why = "holds distances, not a picture" if encoding in _DEPTH else "is not read"
        raise PictureError(IMAGE, f"encoding {encoding[:40]!r} {why}")
    channels, sample_bytes, _order = _LAYOUTS[encoding]
    return width * channels * sample_bytes


def _raw_pixels(picture: CameraPicture, max_width_px: int | None) -> NDArray[np.uint8]:
    if picture.encoding in _BAYER:
        pattern, sample_bytes = _BAYER[picture.encoding]
        mosaic = _samples(picture, 1, sample_bytes)[..., 0]
        is_narrow = max_width_px is not None and 2 * max_width_px <= picture.width_px and picture.height_px > 1
        return binned(mosaic, pattern) if is_narrow else debayered(mosaic, pattern)
    if picture.encoding in yuv.ENCODINGS:
        size_px = (picture.width_px, picture.height_px)
        return yuv.yuv_pixels(picture.data, picture.encoding, size_px, picture.step_bytes)
    channels, sample_bytes, order = _LAYOUTS[picture.encoding]
    return np.ascontiguousarray(_samples(picture, channels, sample_bytes)[..., order])


def _samples(picture: CameraPicture, channels: int, sample_bytes: int) -> NDArray[np.uint8]:
    """Return (H, W, channels): a view of the upper byte of every sample."""
    upper = 0 if sample_bytes == 1 or picture.is_bigendian else 1
    shape = (picture.height_px, picture.width_px, channels)
    strides = (picture.step_bytes, channels * sample_bytes, sample_bytes)
    return np.ndarray(shape, np.uint8, picture.data, upper, strides)


def _narrowed(pixels: NDArray[np.uint8], max_width_px: int | None) -> NDArray[np.uint8]:
    height, width = pixels.shape[:2]
    if max_width_px is None or width <= max_width_px:
        return pixels
    size = (max_width_px, max(1, round(height * max_width_px / width)))
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))


def _decompressed(picture: CameraPicture, max_width_px: int | None) -> NDArray[np.uint8]:
    """Decode with Pillow, limited to one format and the checked size; any error of Pillow means damage."""
    declared = PictureHeader("JPEG" if picture.encoding == "JPEG" else "PNG", picture.width_px, picture.height_px)
    try:
        with Image.open(BytesIO(picture.data), formats=(declared.kind,)) as image:
            if image.size != declared[1:]:
                raise PictureError(COMPRESSED, f"it declares {declared[1:]} and {image.size} pixels")
            if max_width_px is not None:
                image.draft("RGB", (max_width_px, max(1, picture.height_px * max_width_px // picture.width_px)))
            return _narrowed(np.asarray(_eight_bits(image).convert("RGB")), max_width_px)
    except PictureError:
        raise
    except Exception as error:  # OSError, SyntaxError, ValueError, struct.error, zlib.error …
        raise PictureError(COMPRESSED, f"{declared.kind} cannot be decoded ({error})"[:200]) from error


def _eight_bits(image: Image.Image) -> Image.Image:
    """Return a sixteen-bit PNG scaled to eight bits, which Pillow would clip."""
    if not image.mode.startswith("I"):
        return image
    return Image.fromarray((np.asarray(image).astype(np.uint32) >> 8).clip(0, 255).astype(np.uint8))


# Demosaicing: colours of a Bayer image, whose sensor measures one colour per pixel. A pattern names the colours of the
# upper left 2 × 2 pixels, row by row, in ROS' order ("rggb"). Bilinear: a missing colour is the mean of its nearest
# known neighbours, weighted 1 : 2 : 1 in both directions; at the border those that exist. Source: sensor_msgs
# image_encodings; Malvar, He, Cutler, ICASSP 2004, section 2 (bilinear).


CHANNELS = "rgb"


def debayered(mosaic: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """Return (H, W, 3) red, green, blue from (H, W)."""
    picture = np.empty((*mosaic.shape, 3), np.uint8)
    for channel, colour in enumerate(CHANNELS):
        known = np.zeros(mosaic.shape, np.uint16)
        for index, name in enumerate(pattern):
            known[index // 2 :: 2, index % 2 :: 2] = name == colour
        weights = _spread(known)
        sums = _spread(known * mosaic)
        # A picture of one row or column may lack a colour altogether: it stays 0 there.
        picture[..., channel] = (sums + weights // 2) // np.maximum(weights, 1)
    return picture


def binned(mosaic: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """Return (H // 2, W // 2, 3): every 2 × 2 pixels become one, green the mean of its two; for previews."""
    height, width = (size - size % 2 for size in mosaic.shape)
    sums = np.zeros((height // 2, width // 2, 3), np.uint16)
    for index, name in enumerate(pattern):
        sums[..., CHANNELS.index(name)] += mosaic[index // 2 : height : 2, index % 2 : width : 2]
    return (sums // np.array([1, 2, 1], np.uint16)).astype(np.uint8)


def _spread(values: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the sum over 3 × 3 neighbours with weights (1, 2, 1) in both directions, nothing beyond the border."""
    for axis in (0, 1):
        lined = np.moveaxis(values, axis, 0)
        total = lined * np.uint16(2)
        total[1:] += lined[:-1]
        total[:-1] += lined[1:]
        values = np.moveaxis(total, 0, axis)
    return values


# The header of a JPEG or PNG: kind and size, read before any decoding. Sizes are (width, height) pixels. Source: ITU-T
# T.81 annex B (markers), PNG specification 1.2, 4.1.1.

# Twice the largest sensor that the camera's driver supports (24 MP): a larger image is an attack.
MOST_PIXELS = 48_000_000
# A progressive JPEG has about ten scans; each costs a walk over the whole picture, however few bytes it takes.
MOST_SCANS = 100
JPEG_MAGIC, PNG_MAGIC = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
SHOWN_BYTES = 16
# Cameras pad pictures to whole blocks.
END_BYTES = 1 << 12
OTHER_MAGIC = (
    (b"\0\0\0\1", "video (H.264 or H.265)"), (b"\0\0\1", "video (H.264 or H.265)"), (b"RIFF", "WebP"), (b"BM", "BMP"),
    (b"II*\0", "TIFF"), (b"MM\0*", "TIFF"), (b"GIF8", "GIF"), (b"\0\0\0\x20ftyp", "AVIF or HEIF"),
    (b"\0\0\0\0", "a compressed depth image"),
)  # fmt: skip
# Start of frame, without the tables that share its range of markers (DHT, JPG, DAC).
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_ALONE_MARKERS = frozenset({0x01, *range(0xD0, 0xD9)})
_SCAN = 0xDA


class PictureHeader(NamedTuple):
    kind: Literal["JPEG", "PNG"]
    width_px: int
    height_px: int


def head_of(data: bytes, type_name: str) -> PictureHeader:
    """Return kind and declared size. Raises: PictureError (neither JPEG nor PNG, cut off, no size, larger than the
    limit).
    """
    if data.startswith(JPEG_MAGIC):
        head = _jpeg(data, type_name)
    elif data.startswith(PNG_MAGIC):
        head = _png(data, type_name)
    else:
        raise _no_picture(data[:SHOWN_BYTES], type_name)
    check_size(head.width_px, head.height_px, type_name)
    return head


def _no_picture(first: bytes, type_name: str) -> PictureError:
    """Return the error, with the name of another format if the first bytes reveal it."""
    shown = first[:8].hex(" ") or "none"
    name = next((name for magic, name in OTHER_MAGIC if first.startswith(magic)), "")
    return PictureError(type_name, f"first bytes {shown} are neither JPEG nor PNG{f' but {name}' if name else ''}")


def check_end(data: memoryview, type_name: str) -> None:
    """Raise PictureError for a JPEG or PNG that was cut off."""
    kind, mark = ("JPEG", b"\xff\xd9") if data[:3] == JPEG_MAGIC else ("PNG", b"IEND")
    if mark not in bytes(data[-END_BYTES:]):
        raise PictureError(type_name, f"the {kind} was cut off: it has no end")


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
    """Walk the segments up to the frame header; only lengths are used, and they are checked."""
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
    raise PictureError(type_name, "the JPEG ends before its size")
