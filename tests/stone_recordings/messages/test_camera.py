"""Images become the pixels that were taken; what is not an image is refused before it costs anything."""

import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from stone_recordings.bags.errors import IngestError, MessageLayoutError, PoseValueError
from stone_recordings.messages import problems
from stone_recordings.messages.camera import (
    COMPRESSED,
    IMAGE,
    MOST_SCANS,
    binned,
    debayered,
    decode_image,
    picture_of,
    picture_problem,
)
from stone_recordings.messages.errors import PictureError
from tests.stone_recordings.writing import header, made, serialised

# Where red, green and blue are in a pixel as it is sent.
ORDERS = {
    "rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "mono8": (0, 0, 0),
    "rgb16": (0, 1, 2), "bgr16": (2, 1, 0), "mono16": (0, 0, 0), "rgba16": (0, 1, 2), "bgra16": (2, 1, 0),
}  # fmt: skip
PATTERNS = ("rggb", "bggr", "gbrg", "grbg")


def _image(encoding: str, data: bytes, size: tuple[int, int], step: int, **said: Any) -> memoryview:
    fields = {"height": size[0], "width": size[1], "encoding": encoding, "is_bigendian": 0, "step": step} | said
    content = np.frombuffer(data, np.uint8)
    return memoryview(serialised(made(IMAGE, header=header(5, "cam"), data=content, **fields)))


def _compressed(data: bytes, text: str = "bgr8; jpeg compressed bgr8") -> memoryview:
    content = np.frombuffer(data, np.uint8)
    return memoryview(serialised(made(COMPRESSED, header=header(5, "cam"), format=text, data=content)))


def _encoded(pixels: NDArray[Any], kind: str, **options: Any) -> bytes:
    file = BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def _random(shape: tuple[int, ...], seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@pytest.mark.parametrize("encoding", ORDERS)
@pytest.mark.parametrize("is_bigendian", [0, 1])
def test_raw_images_are_their_bytes_in_order(encoding: str, is_bigendian: int) -> None:
    channels = 1 if "mono" in encoding else 4 if "a" in encoding else 3
    samples = _random((6, 5, channels), 3)
    rows = samples
    if encoding.endswith("16"):
        halves = (samples, _random(samples.shape, 9)) if is_bigendian else (_random(samples.shape, 9), samples)
        rows = np.stack(halves, axis=-1).reshape(6, -1)
    padded = np.pad(rows.reshape(6, -1), ((0, 0), (0, 7)))
    payload = _image(encoding, padded.tobytes(), (6, 5), padded.shape[1], is_bigendian=is_bigendian)
    picture = decode_image(payload, IMAGE)
    assert (picture.stamp_ns, picture.frame_id, picture.width_px, picture.height_px) == (5, "cam", 5, 6)
    np.testing.assert_array_equal(picture.pixels(), samples[..., ORDERS[encoding]])


def _slowly_debayered(mosaic: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """Pixel by pixel: the weighted mean of the neighbours that see the colour."""
    height, width = mosaic.shape
    picture = np.zeros((height, width, 3), np.uint8)
    for y, x, channel in np.ndindex(height, width, 3):
        total = weight = 0
        for dy, dx in np.ndindex(3, 3):
            v, u = y + dy - 1, x + dx - 1
            if 0 <= v < height and 0 <= u < width and pattern[2 * (v % 2) + u % 2] == "rgb"[channel]:
                share = (2 - abs(dy - 1)) * (2 - abs(dx - 1))
                total, weight = total + share * int(mosaic[v, u]), weight + share
        picture[y, x, channel] = (total + weight // 2) // max(weight, 1)
    return picture


@settings(max_examples=30)
@given(
    height=st.integers(1, 7), width=st.integers(1, 7), pattern=st.sampled_from(PATTERNS), seed=st.integers(0, 2**32 - 1)
)
def test_debayering_is_the_mean_of_the_nearest(height: int, width: int, pattern: str, seed: int) -> None:
    mosaic = _random((height, width), seed)
    np.testing.assert_array_equal(debayered(mosaic, pattern), _slowly_debayered(mosaic, pattern))


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("bits", [8, 16])
def test_one_colour_everywhere_stays_that_colour(pattern: str, bits: int) -> None:
    colour = np.array([200, 120, 30], np.uint8)
    mosaic = np.zeros((8, 10), np.uint8)
    for place, name in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = colour["rgb".index(name)]
    data = mosaic if bits == 8 else mosaic.astype(np.uint16) << 8
    payload = _image(f"bayer_{pattern}{bits}", data.tobytes(), (8, 10), 10 * bits // 8)
    np.testing.assert_array_equal(picture_of(IMAGE, payload), np.broadcast_to(colour, (8, 10, 3)))
    np.testing.assert_array_equal(binned(mosaic, pattern), np.broadcast_to(colour, (4, 5, 3)))
    assert picture_of(IMAGE, payload, 5).shape == (4, 5, 3)


def test_compressed_images_are_told_by_their_first_bytes_be_they_grey_or_of_16_bits() -> None:
    smooth = np.linspace(0, 255, 40 * 60 * 3).reshape(40, 60, 3).astype(np.uint8)
    np.testing.assert_array_equal(picture_of(COMPRESSED, _compressed(_encoded(smooth, "PNG"), "jpeg")), smooth)
    lossy = picture_of(COMPRESSED, _compressed(_encoded(smooth, "JPEG", quality=95), "png"))
    assert np.abs(lossy.astype(int) - smooth).max() < 16
    assert decode_image(_compressed(_encoded(smooth, "JPEG")), COMPRESSED).encoding == "JPEG"
    grey = _random((9, 11))
    for content in (_encoded(grey, "PNG"), _encoded(grey.astype(np.uint16) << 8, "PNG")):
        np.testing.assert_array_equal(
            picture_of(COMPRESSED, _compressed(content)), np.broadcast_to(grey[..., None], (9, 11, 3))
        )


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_a_narrow_picture_keeps_its_shape(kind: str) -> None:
    content = _encoded(_random((600, 960, 3)), kind)
    assert picture_of(COMPRESSED, _compressed(content), 320).shape == (200, 320, 3)
    assert picture_of(COMPRESSED, _compressed(content), 5000).shape == (600, 960, 3)


def _png_of(width: int, height: int) -> bytes:
    """A header that declares any size; little else."""
    ihdr = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\x02\0\0\0"
    idat = b"IDAT" + zlib.compress(bytes(1000))
    chunks = (len(c[4:]).to_bytes(4, "big") + c + zlib.crc32(c).to_bytes(4, "big") for c in (ihdr, idat, b"IEND"))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def _jpeg_of(width: int, height: int) -> bytes:
    content = _encoded(_random((8, 8, 3)), "JPEG")
    at = content.index(b"\xff\xc0")
    return content[: at + 5] + height.to_bytes(2, "big") + width.to_bytes(2, "big") + content[at + 9 :]


REFUSED = {
    "a bomb of a PNG": _png_of(100_000, 100_000), "a bomb of a JPEG": _jpeg_of(65_535, 65_535),
    "no width": _png_of(0, 7), "scans without end": _encoded(_random((8, 8, 3)), "JPEG") + b"\xff\xda" * MOST_SCANS,
    "half a JPEG": _encoded(_random((64, 64, 3)), "JPEG")[:700], "a PNG whose pixels are missing": _png_of(500, 500),
    "a film": b"\0\0\0\1\x67\x42\0\x1e", "nothing": b"",
    "a JPEG without a frame": b"\xff\xd8\xff\xe0\0\x04\0\0\xff\xda\0\x02" + bytes(30),
    "a JPEG of anything": b"\xff\xd8\xff\xe0\0\x03\0\0\0\0\0",
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_picture_that_is_none_is_refused(case: str) -> None:
    with pytest.raises(PictureError) as caught:
        picture_of(COMPRESSED, _compressed(REFUSED[case]))
    assert caught.value.code == "MSG-306"


@pytest.mark.parametrize("step", [0, 5, 14, 16, 2**32 - 1])
def test_a_step_that_the_bytes_refute_is_ignored_and_named(step: int) -> None:
    data = bytes(range(90))
    picture = decode_image(_image("rgb8", data, (6, 5), step), IMAGE)
    assert picture.pixels().tobytes() == data
    assert picture.ignored == f"step {step} against 90 bytes of data"


RAW_REFUSED = {
    "too few rows": ((7, 5), 15, "rgb8"),
    "a step smaller than a row": ((5, 5), 14, "rgb8"),
    "an encoding of another world": ((6, 5), 15, "yuv422_nv21"),
    "no rows": ((0, 5), 15, "rgb8"),
    "more pixels than any camera": ((60_000, 60_000), 15, "rgb8"),
}


@pytest.mark.parametrize("case", RAW_REFUSED)
def test_a_raw_image_that_lies_is_refused(case: str) -> None:
    size, step, encoding = RAW_REFUSED[case]
    with pytest.raises(PictureError):
        decode_image(_image(encoding, bytes(90), size, step), IMAGE)


@settings(max_examples=60)
@given(
    kind=st.sampled_from(["raw", "JPEG", "PNG"]),
    ratio=st.floats(0, 1, exclude_max=True),
    junk=st.binary(min_size=1, max_size=8),
    is_cut=st.booleans(),
)
def test_damaged_images_are_read_or_refused_by_code(kind: str, ratio: float, junk: bytes, is_cut: bool) -> None:
    pixels = _random((16, 24, 3))
    payload = _image("rgb8", pixels.tobytes(), (16, 24), 72) if kind == "raw" else _compressed(_encoded(pixels, kind))
    type_name, content = (IMAGE if kind == "raw" else COMPRESSED), bytes(payload)
    at = int(ratio * len(content))
    damaged = content[:at] + junk + (b"" if is_cut else content[at + len(junk) :])
    try:
        found = str(picture_of(type_name, memoryview(damaged), 20).dtype)
    except IngestError as error:
        found = error.code[:5]
    assert found in ("uint8", "MSG-3")


@dataclass(frozen=True)
class Note:
    payload: memoryview


def notes(*texts: bytes) -> list[Note]:
    return [Note(memoryview(text)) for text in texts]


def read(messages: list[Note]) -> int:
    """Messages are sound but for those that say "bad"."""
    if any(message.payload == b"bad" for message in messages):
        raise MessageLayoutError("note", "it is bad")
    return len(messages)


def test_those_that_can_be_read_are_left_and_the_others_said() -> None:
    good, findings = problems.readable("/note", notes(b"a", b"bad", b"c", b"d", b"bad"), read)
    assert [bytes(message.payload) for message in good] == [b"a", b"c", b"d"]
    assert [(finding.code, finding.topic) for finding in findings] == [("MSG-311", "/note")]
    assert "2 of 5 messages cannot be read" in findings[0].message
    assert "number 1: note: it is bad" in findings[0].message

    def poses(messages: list[Note]) -> None:
        read(messages)
        raise PoseValueError("note", 0, "is not finite")

    assert len(problems.readable("/note", notes(b"a", b"bad", b"c"), poses)[0]) == 2


@pytest.mark.parametrize("texts", [(), (b"a", b"b"), (b"bad", b"bad")], ids=["none", "all good", "all bad"])
def test_nothing_is_left_out_where_all_or_none_can_be_read(texts: tuple[bytes, ...]) -> None:
    assert len(problems.readable("/note", notes(*texts), read)[0]) == len(texts)
    assert problems.readable("/note", notes(*texts), read)[1] == ()


def picture(data: bytes, stamp_s: int = 7) -> bytes:
    content = np.frombuffer(data, np.uint8)
    return serialised(made(COMPRESSED, header=header(stamp_s * 10**9, "camera"), format="jpeg", data=content))


@pytest.mark.parametrize(
    ("head", "code", "reason"),
    [
        (picture(b"\xff\xd8\xff and more\xff\xd9"), "", ""),
        (picture(b"\xff\xd8\xff\xff\xd9", stamp_s=0), "no_stamp", "its stamp is 0"),
        (picture(b"noise"), "malformed_sweep", "neither JPEG nor PNG"),
        (picture(b""), "malformed_sweep", "first bytes none"),
        (picture(b"\xff\xd8\xff and more")[:-4], "malformed_sweep", "its picture ends at byte"),
        (picture(b"\xff\xd8\xff")[:10], "malformed_sweep", "8 bytes are declared at"),
        (b"\0\0" + picture(b"\xff\xd8\xff")[2:], "malformed_sweep", "big-endian"),
        (b"", "malformed_sweep", "0 bytes are not a CDR message"),
    ],
)
def test_the_first_bytes_tell_what_is_wrong(head: bytes, code: str, reason: str) -> None:
    found = problems.head_problem(memoryview(head), "sensor_msgs/msg/CompressedImage", lambda: len(head))
    assert (found.code if found else "") == code
    assert reason in (found.reason if found else "")


def test_damage_is_said_once_and_of_words_as_common_the_first_counts() -> None:
    damaged, other = (
        problems.MessageProblem("damaged_chunk", "CRC"),
        problems.MessageProblem("no_stamp", "its stamp is 0"),
    )
    stamps_ns = np.array([10, 20, 30], np.int64)
    assert problems.left_out_finding("/a", {0: damaged}, stamps_ns) == ()
    (found,) = problems.left_out_finding("/a", {0: damaged, 2: other}, stamps_ns)
    assert "1 of 3 messages are left out (the first at 30 ns: its stamp is 0)" in found.message
    assert [problems.majority(words) for words in ([], ["b", "a"], ["b", "a", "a"])] == ["", "b", "a"]


IMU = "sensor_msgs/msg/Imu"


def imu_head(seconds: int, nanoseconds: int, frame_id: bytes, behind: bytes, encapsulation: bytes) -> bytes:
    stamp = seconds.to_bytes(4, "little", signed=True) + nanoseconds.to_bytes(4, "little")
    return encapsulation + stamp + len(frame_id).to_bytes(4, "little") + frame_id + behind


heads = st.builds(
    imu_head,
    st.sampled_from([0, 1, -1, 1_700_000_000]),
    st.sampled_from([0, 5, 1_000_000_000]),
    st.sampled_from([b"imu\0", b"\0", b"", b"other\0", b"\xff\xff"]),
    st.sampled_from([b"", b"more"]),
    st.sampled_from([b"\0\1\0\0", b"\0\0\0\0", b"\0\2\0\0"]),
)


@given(
    st.lists(st.tuples(heads, st.integers(0, 40)), max_size=12), st.sampled_from([IMU, "sensor_msgs/msg/CameraInfo"])
)
def test_a_topic_s_heads_are_each_told_as_alone(cut: list[tuple[bytes, int]], type_name: str) -> None:
    topic = problems.TopicHeads(type_name)
    for head, bytes_left in cut:
        view = memoryview(head[: max(0, len(head) - bytes_left // 4)])
        assert topic.problem(view, lambda: 0) == problems.head_problem(view, type_name, lambda: 0)


# Of each encoding: where Y, U and V of a pixel are, by the definitions of V4L2 (YUYV, UYVY, NV12, NV21, NV24).
def _places(encoding: str, x: int, y: int, size: tuple[int, int], step: int) -> tuple[int, int, int]:
    height = size[0]
    pair, row = y * step + 4 * (x // 2), (height + y // 2) * step + 2 * (x // 2)
    if encoding in ("yuv422_yuy2", "yuyv"):
        return y * step + 2 * x, pair + 1, pair + 3
    if encoding in ("yuv422", "uyvy"):
        return y * step + 2 * x + 1, pair, pair + 2
    if encoding == "nv24":
        row = height * step + y * 2 * step + 2 * x
    return y * step + x, *((row + 1, row) if encoding == "nv21" else (row, row + 1))


def _rgb_of(y: float, u: float, v: float) -> NDArray[np.float64]:
    """By the matrix of BT.601 that makes Y'CbCr of R'G'B', inverted."""
    forward = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])
    full = np.array([(max(y, 16) - 16) / 219, (u - 128) / 224, (v - 128) / 224])
    return np.asarray((255 * (np.linalg.inv(forward) @ full)).clip(0, 255))


@pytest.mark.parametrize("encoding", ["yuv422_yuy2", "yuyv", "yuv422", "uyvy", "nv12", "nv21", "nv24"])
@pytest.mark.parametrize(("size", "pad"), [((4, 6), 0), ((4, 6), 2), ((150, 4), 0), ((2, 2), 4)])
def test_pictures_of_brightness_and_colour_are_those_of_bt_601(encoding: str, size: tuple[int, int], pad: int) -> None:
    height, width = size
    packed = encoding in ("yuv422_yuy2", "yuyv", "yuv422", "uyvy")
    step = (2 * width if packed else width) + pad
    rows = height if packed else height + height // 2 if encoding != "nv24" else 3 * height
    data = _random((rows * step,), 5)
    pixels = picture_of(IMAGE, _image(encoding, data.tobytes(), size, step))
    for y, x in np.ndindex(height, width):
        expected = _rgb_of(*(float(data[at]) for at in _places(encoding, x, y, size, step)))
        np.testing.assert_allclose(pixels[y, x], expected, atol=0.51 + 0.01)


@pytest.mark.parametrize("encoding", ["yuv422_yuy2", "nv12", "nv21", "nv24"])
def test_a_grey_picture_of_limited_range_is_black_to_white(encoding: str) -> None:
    height, width, step = 3, 5, 12
    rows = {"yuv422_yuy2": 3, "nv12": 5, "nv21": 5, "nv24": 9}[encoding]
    for level, shown in ((16, 0), (235, 255)):
        data = np.full((rows, step), 128, np.uint8)
        if encoding == "yuv422_yuy2":
            data[:, ::2] = level
        else:
            data[:height] = level
        pixels = picture_of(IMAGE, _image(encoding, data.tobytes(), (height, width), step))
        np.testing.assert_array_equal(pixels, np.full((height, width, 3), shown))


@pytest.mark.parametrize(
    ("payload", "word"),
    [
        (_image("yuv422_i420", bytes(40), (2, 2), 20), "'yuv422_i420' is not read"),
        (_image("32FC1", bytes(32), (2, 4), 16), "distances"),
        (_image("16UC1", bytes(16), (2, 4), 8), "distances"),
        (_image("rgb8", b"", (0, 0), 0), "0 × 0"),
        (_compressed(b"\0\0\0\1\x67abc", "h264"), "H.264"),
        (_compressed(b"RIFFabcdWEBP", "webp"), "WebP"),
        (_compressed(b"", "jpeg"), "none"),
        (_compressed(_encoded(_random((9, 9, 3)), "PNG")[:-30]), "cut off"),
        (_compressed(_encoded(_random((9, 9, 3)), "JPEG")[:-30]), "cut off"),
    ],
)
def test_a_picture_that_cannot_be_read_is_named_by_its_head_as_by_decoding(payload: memoryview, word: str) -> None:
    type_name = IMAGE if any(one in word for one in ("yuv", "distances", "0 × 0")) else COMPRESSED
    assert word in picture_problem(payload, type_name, lambda: len(payload))
    with pytest.raises(PictureError):
        picture_of(type_name, payload)
