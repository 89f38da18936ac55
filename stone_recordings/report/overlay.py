"""The LiDAR's points drawn on each camera's picture, coloured by range, to judge a calibration by eye.

**Conventions.** One picture per camera, of a frame in the middle of those with a picture, compensated for the motion
between sweep and exposure. Near points are red and drawn last, far points blue, on a logarithmic scale that is part of
the picture. The picture is scaled to the calibrated size; different sizes (CAL-403) show as a misfit. An undecodable
picture is left out; `picture_findings` reports it.
"""

import re
from collections.abc import Iterator
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.projection import project
from stone.sensors.sequence import Sequence
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.camera import picture_of
from stone_recordings.sync.camera_sweeps import CameraSweepPair, pairs
from stone_recordings.sync.sweeps import BagSweeps

JPEG = "image/jpeg"
WIDEST_PX = 1280
JPEG_QUALITY = 85
NEAREST_M, FARTHEST_M = 1.0, 60.0
PIXELS_PER_DOT = 30
READABLE = 20
"""The height of the picture in lines of its text: a page shows it at a third of its size."""
TICKS_M = (1, 3, 10, 30, 60)
# Google's Turbo as polynomials of degree 5 in [0, 1] (A. Mikhailov and R. du Bois, 2019), constant term first.
TURBO = np.array(
    [
        (0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
        (0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
        (0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
    ]
)


def overlays_of(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> Iterator[tuple[str, str, bytes]]:
    """Yield (name, media type, bytes) of each camera: "overlay_CAM_FRONT.jpg", "image/jpeg". None without cameras.

    Raises the errors of reading the bag (BAG-*) and of `sweeps.sweep_in`.
    """
    types = {topic.name: topic.type for topic in bag.topics}
    given: set[str] = set()
    for pair in pairs(bag, sequence, sweeps, 1):
        payload = bag.message(pair.topic, pair.message_index).payload
        try:
            pixels = picture_of(types[pair.topic], payload, WIDEST_PX)
        except IngestError:
            continue
        name = _file_name(pair.mount.name, len(given), given)
        given.add(name)
        yield name, JPEG, drawn(pixels, pair)


def drawn(pixels: NDArray[np.uint8], pair: CameraSweepPair) -> bytes:
    """Return a JPEG of the picture (H, W, 3) with the pair's points on it."""
    shown = pixels.copy()
    if pair.mount.intrinsics is not None:
        _paint(shown, pair, pair.mount.intrinsics)
    image = Image.fromarray(shown)
    _scale(image, pair.mount.name)
    buffer = BytesIO()
    image.save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()


def range_colours(range_m: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return red, green, blue (N, 3) of ranges (N,): red at 1 m and nearer, blue at 60 m and beyond."""
    ratio = np.log(np.clip(range_m, NEAREST_M, FARTHEST_M) / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M)
    powers = (0.95 - 0.9 * ratio)[:, None] ** np.arange(TURBO.shape[1])
    return np.asarray(np.clip(powers @ TURBO.T, 0, 1) * 255, np.uint8)


def _paint(pixels: NDArray[np.uint8], pair: CameraSweepPair, intrinsics: CameraIntrinsics) -> None:
    """Draw square dots, far ones first: if several meet in one pixel, numpy keeps the last."""
    height_px, width_px = pixels.shape[:2]
    points_camera = pair.points_camera
    projected, is_in_image = project(points_camera, intrinsics)
    is_in_image[np.flatnonzero(is_in_image)] = _thinned(int(is_in_image.sum()), height_px * width_px)
    range_m = np.linalg.norm(points_camera[is_in_image], axis=1)
    order = np.argsort(-range_m, kind="stable")
    scale = (width_px / intrinsics.width_px, height_px / intrinsics.height_px)
    places = ((projected[is_in_image][order] + 0.5) * scale).astype(np.int64)
    reach = np.arange(-max(width_px // 900, 1), max(width_px // 900, 1) + 1)
    dot = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
    spread = np.clip((places[:, None] + dot).reshape(-1, 2), 0, (width_px - 1, height_px - 1))
    pixels[spread[:, 1], spread[:, 0]] = np.repeat(range_colours(range_m[order]), len(dot), axis=0)


def _thinned(count: int, area_px: int) -> NDArray[np.bool_]:
    """Return a mask of every n-th of `count` points, so that most of the picture stays visible."""
    step = 1 + count * PIXELS_PER_DOT // area_px
    return np.asarray(np.arange(count) % step == 0)


def _scale(image: Image.Image, name: str) -> None:
    """Draw the colours' legend along the lower edge, and the channel in the upper left corner."""
    width_px, height_px = image.size
    high_px, wide_px = max(4, height_px // 60), width_px // 2
    left_px, top_px = width_px // 40, height_px - 3 * high_px
    ranges_m = np.geomspace(NEAREST_M, FARTHEST_M, max(wide_px, 2))
    bar = np.broadcast_to(range_colours(ranges_m), (high_px, len(ranges_m), 3))
    image.paste(Image.fromarray(np.ascontiguousarray(bar)), (left_px, top_px))
    pen, size_px = ImageDraw.Draw(image), max(9, height_px // READABLE)
    outlined = {"fill": "white", "stroke_width": 1, "stroke_fill": "black", "font_size": size_px}
    for range_m in TICKS_M:
        x_px = left_px + float(np.log(range_m / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M)) * wide_px
        pen.text((x_px, top_px - 1.3 * size_px), f"{range_m} m", **outlined)  # type: ignore[arg-type]
    pen.text((left_px, size_px / 2), name, **outlined)  # type: ignore[arg-type]


def _file_name(channel: str, number: int, given: set[str]) -> str:
    """Return a plain file name that differs from the earlier ones, whatever the camera's name."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", channel)[:60]
    name = f"overlay_{plain}.jpg"
    return f"overlay_{plain}_{number}.jpg" if name in given else name
