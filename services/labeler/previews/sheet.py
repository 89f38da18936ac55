"""One sheet per frame: three cameras above, three below, and between them the labels from above and in perspective.

The arrangement of the paper's Fig. 6. A camera without a picture leaves a blank that says so.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from PIL import Image, ImageDraw, ImageOps

from services.labeler.exports.source import LabelledSequence
from services.labeler.previews.bev import bev
from services.labeler.previews.lettering import chip, font, legend
from services.labeler.previews.oblique import oblique
from services.labeler.previews.picture_opening import opened
from services.labeler.previews.surroundings import surroundings_of
from stone.labels.class_colours import INK, PAPER
from stone.sensors.samples import CameraSample

ABOVE = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT")
BELOW = ("CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
WIDTH_PX, GAP_PX, PLAN_PX, BAR_PX = 1280, 8, 456, 84
CAMERA_PX = (WIDTH_PX - 4 * GAP_PX) // 3
USUAL_RATIO, LEAST_RATIO, MOST_RATIO = 0.625, 0.4, 0.75
LABEL_PX, BAR_TEXT_PX = 22, 25
BLANK, SOFT = (214, 214, 210), (96, 102, 110)


@dataclass(frozen=True, eq=False)
class FramePictures:
    """The labels from above and in perspective, and the sheet that shows both among the cameras."""

    plan: Image.Image
    oblique: Image.Image
    sheet: Image.Image


@dataclass(frozen=True)
class _Rectangle:
    """Left, top, width and height, pixels."""

    x: int
    y: int
    width: int
    height: int


def frame_pictures(source: LabelledSequence, index: int) -> FramePictures:
    """The pictures of frame `index`, `oblique.WIDTH_PX` and `bev.SIDE_PX` wide, and the sheet `WIDTH_PX` wide.

    Raises IndexError, and what the source raises.
    """
    grids, around = source.grids(index), surroundings_of(source.sequence, index)
    return FramePictures(bev(grids, around), oblique(grids, around), frame_sheet(source, index))


def frame_sheet(source: LabelledSequence, index: int, ratio: float | None = None) -> Image.Image:
    """The sheet alone; `ratio` is the height to width of the cameras' cells, else that of the frame's first picture."""
    samples = {channel: source.samples.camera(channel, index) for channel in (*ABOVE, *BELOW)}
    ratio = ratio or cell_ratio(samples.values())
    high_px = _camera_height_px(ratio)
    top_px, low_px = 2 * GAP_PX + high_px, 3 * GAP_PX + high_px + PLAN_PX
    sheet = Image.new("RGB", sheet_size(ratio), PAPER)
    for row, channels in ((GAP_PX, ABOVE), (low_px, BELOW)):
        for column, channel in enumerate(channels):
            place = _Rectangle(GAP_PX + column * (CAMERA_PX + GAP_PX), row, CAMERA_PX, high_px)
            _place_camera(sheet, place, channel, samples[channel])
    grids, around = source.grids(index), surroundings_of(source.sequence, index)
    size_px = (WIDTH_PX - 3 * GAP_PX - PLAN_PX, PLAN_PX)
    sheet.paste(bev(grids, around, PLAN_PX), (GAP_PX, top_px))
    sheet.paste(oblique(grids, around, size_px), (2 * GAP_PX + PLAN_PX, top_px))
    _write_bar(sheet, source, index)
    return sheet


def sheet_size(ratio: float) -> tuple[int, int]:
    """Width and height of a sheet whose cameras' cells have this height to width; both even, as films ask."""
    return WIDTH_PX, 3 * GAP_PX + 2 * _camera_height_px(ratio) + PLAN_PX + BAR_PX


def _camera_height_px(ratio: float) -> int:
    return round(CAMERA_PX * ratio) // 2 * 2


def cell_ratio(samples: Iterable[CameraSample | None]) -> float:
    """Height to width of the first picture, within reason."""
    ratio = next((one.height_px / one.width_px for one in samples if one is not None), USUAL_RATIO)
    return min(max(ratio, LEAST_RATIO), MOST_RATIO)


def _place_camera(sheet: Image.Image, place: _Rectangle, channel: str, sample: CameraSample | None) -> None:
    picture = opened(sample, (place.width, place.height))
    cell = Image.new("RGB", (place.width, place.height), BLANK)
    if isinstance(picture, Image.Image):
        picture = ImageOps.contain(picture, cell.size, Image.Resampling.BILINEAR)
        cell.paste(picture, ((cell.width - picture.width) // 2, (cell.height - picture.height) // 2))
    else:
        pen = ImageDraw.Draw(cell)
        pen.text((cell.width / 2, cell.height / 2), picture, SOFT, font(LABEL_PX), anchor="mm")
    chip(cell, (6, cell.height - 6), channel, LABEL_PX)
    sheet.paste(cell, (place.x, place.y))


def _write_bar(sheet: Image.Image, source: LabelledSequence, index: int) -> None:
    """Frame, time and sequence above the legend."""
    sequence = source.sequence
    stamps_ns = sequence.frames.stamps_ns
    since_s = (int(stamps_ns[index]) - int(stamps_ns[0])) / 1e9
    utc = datetime.fromtimestamp(int(stamps_ns[index]) // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    left, top = GAP_PX + 2, sheet.height - BAR_PX
    pen = ImageDraw.Draw(sheet)
    words = f"frame {index + 1} / {len(stamps_ns)}   {since_s:.1f} s   {utc}"
    pen.text((left, top + BAR_PX * 0.27), words, INK, font(BAR_TEXT_PX), anchor="lm")
    room_px = WIDTH_PX - 2 * left - pen.textlength(words, font(BAR_TEXT_PX)) - 2 * BAR_TEXT_PX
    name = _fitted(sequence.name, room_px, pen)
    pen.text((WIDTH_PX - left, top + BAR_PX * 0.27), name, SOFT, font(BAR_TEXT_PX), anchor="rm")
    legend(sheet, (left, top + BAR_PX * 0.73), BAR_TEXT_PX)


def _fitted(name: str, room_px: float, pen: ImageDraw.ImageDraw) -> str:
    """The name, cut where there is no room for it."""
    while name and pen.textlength(name, font(BAR_TEXT_PX)) > room_px:
        name = name[:-2].rstrip("…") + "…" if len(name) > 2 else ""
    return name
