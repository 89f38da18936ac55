"""One picture of every camera at the middle of the recording, labelled, in the order of the ring: front above back.

**Conventions.** Tiles are 480 pixels wide, three in a row, with the first picture's aspect ratio; other pictures are
fitted in. A camera with unreadable pictures has a tile with the reason. RGB, JPEG.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from stone.errors import StoneError
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.messages.camera import picture_of
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.quality.markup import plain
from stone_recordings.report.quality.sampling import RecordingSpan, cameras_of, span_of

TILE_WIDTH_PX, COLUMNS, GAP_PX = 480, 3, 6
LEAST_RATIO, USUAL_RATIO, MOST_RATIO = 0.4, 0.625, 1.5
LABEL_PX, LONGEST_LABEL = 18, 36
JPEG_QUALITY = 85
BACKGROUND, TILE, INK, SOFT = (18, 21, 15), (36, 41, 32), (255, 255, 255), (190, 196, 184)
# Positions to read if the middle cannot be read.
PLACES = (0.5, 0.25, 0.75)


@dataclass(frozen=True, eq=False)
class _Tile:
    """`pixels` (H, W, 3), or None and the `reason`."""

    label: str
    pixels: NDArray[np.uint8] | None
    reason: str


def camera_strip(bag: Bag, inspection: Inspection) -> bytes | None:
    """Return the strip; None for a recording without cameras."""
    cameras = cameras_of(inspection)
    if not cameras:
        return None
    span = span_of(bag)
    tiles = [_tile(bag, topic, channel or topic.name, span) for topic, channel in cameras]
    height_px = round(TILE_WIDTH_PX * _ratio(tiles))
    rows, columns = -(-len(tiles) // COLUMNS), min(COLUMNS, len(tiles))
    size = (columns * (TILE_WIDTH_PX + GAP_PX) - GAP_PX, rows * (height_px + GAP_PX) - GAP_PX)
    sheet = Image.new("RGB", size, BACKGROUND)
    for index, tile in enumerate(tiles):
        row, column = divmod(index, COLUMNS)
        sheet.paste(_drawn(tile, height_px), (column * (TILE_WIDTH_PX + GAP_PX), row * (height_px + GAP_PX)))
    stream = BytesIO()
    sheet.save(stream, "JPEG", quality=JPEG_QUALITY, optimize=True)
    return stream.getvalue()


def _tile(bag: Bag, topic: Topic, label: str, span: RecordingSpan) -> _Tile:
    """Return the picture nearest to the middle in time, else one a quarter away."""
    times_ns = bag.log_times_ns(topic.name)
    reason = ""
    for share in PLACES:
        asked_ns = span.start_ns + round(share * span.length_ns)
        index = min(int(np.searchsorted(times_ns, asked_ns)), len(times_ns) - 1)
        try:
            return _Tile(label, picture_of(topic.type, bag.message(topic.name, index).payload, TILE_WIDTH_PX), "")
        except StoneError as error:
            reason = reason or error.code
    return _Tile(label, None, reason)


def _ratio(tiles: list[_Tile]) -> float:
    """Return height to width of the first picture, bounded."""
    shapes = [tile.pixels.shape for tile in tiles if tile.pixels is not None]
    ratio = shapes[0][0] / shapes[0][1] if shapes else USUAL_RATIO
    return min(max(ratio, LEAST_RATIO), MOST_RATIO)


def _drawn(tile: _Tile, height_px: int) -> Image.Image:
    canvas = Image.new("RGB", (TILE_WIDTH_PX, height_px), TILE)
    draw = ImageDraw.Draw(canvas, "RGBA")
    if tile.pixels is not None:
        picture = Image.fromarray(tile.pixels)
        scale = min(TILE_WIDTH_PX / picture.width, height_px / picture.height)
        fitted = (max(1, round(picture.width * scale)), max(1, round(picture.height * scale)))
        picture = picture.resize(fitted, Image.Resampling.BICUBIC)
        canvas.paste(picture, ((TILE_WIDTH_PX - picture.width) // 2, (height_px - picture.height) // 2))
    else:
        centre = (TILE_WIDTH_PX / 2, height_px / 2)
        draw.text(centre, f"no picture ({tile.reason})", SOFT, _font(LABEL_PX), anchor="mm")
    label = plain(tile.label, LONGEST_LABEL)
    left, top, right, bottom = draw.textbbox((12, height_px - 12), label, _font(LABEL_PX), anchor="ls")
    draw.rounded_rectangle((left - 8, top - 6, right + 8, bottom + 6), 6, (*BACKGROUND, 200))
    draw.text((12, height_px - 12), label, INK, _font(LABEL_PX), anchor="ls")
    return canvas


def _font(size_px: int) -> ImageFont.FreeTypeFont:
    """Return matplotlib's own font, which is the same on every machine."""
    file = Path(mpl.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")
    return ImageFont.truetype(file, size_px, layout_engine=ImageFont.Layout.BASIC)
