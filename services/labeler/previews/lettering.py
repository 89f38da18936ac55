"""Text on preview images: typeface, captions and the class legend."""

from functools import lru_cache
from pathlib import Path

import matplotlib as mpl
from PIL import Image, ImageDraw, ImageFont

from stone.labels.class_colours import CLASS_NAME, CLASS_RGB, INK, PAPER, TRACK, UNSEEN

CHIP_ALPHA = 210
SWATCH_GAP_RATIO, ENTRY_GAP_RATIO = 0.45, 1.1


@lru_cache(maxsize=16)
def font(size_px: int) -> ImageFont.FreeTypeFont:
    """Return matplotlib's bundled font, so that letters are the same everywhere."""
    file = Path(mpl.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")
    return ImageFont.truetype(file, size_px, layout_engine=ImageFont.Layout.BASIC)


def chip(image: Image.Image, corner: tuple[int, int], text: str, size_px: int) -> None:
    """Draw dark text on a light plate; `corner` is the plate's lower left."""
    pen = ImageDraw.Draw(image, "RGBA")
    pad = size_px // 3
    at = (corner[0] + pad, corner[1] - pad)
    left, _, right, _ = pen.textbbox(at, text, font(size_px), anchor="ld")
    top = corner[1] - 2 * pad - round(1.1 * size_px)
    pen.rounded_rectangle((left - pad, top, right + pad, corner[1]), pad, (*PAPER, CHIP_ALPHA))
    pen.text((at[0], (top + corner[1]) / 2), text, INK, font(size_px), anchor="lm")


def legend(image: Image.Image, position: tuple[float, float], size_px: int, *, with_unseen: bool = True) -> None:
    """Draw the legend of classes, track and unobserved from `place` (x, y of the middle line) to the right."""
    pen = ImageDraw.Draw(image)
    x, y = position
    half = size_px * 0.45
    for kind, name in CLASS_NAME.items():
        pen.rectangle((x, y - half, x + 2 * half, y + half), fill=CLASS_RGB[kind])
        x = _word(pen, (x + 2 * half, y), name, size_px)
    pen.line((x, y, x + 2 * half, y), fill=TRACK, width=max(2, size_px // 4))
    x = _word(pen, (x + 2 * half, y), "track", size_px)
    if with_unseen:
        pen.rectangle((x, y - half, x + 2 * half, y + half), fill=UNSEEN)
        _word(pen, (x + 2 * half, y), "never seen", size_px)


def _word(pen: ImageDraw.ImageDraw, position: tuple[float, float], text: str, size_px: int) -> float:
    x = position[0] + SWATCH_GAP_RATIO * size_px
    pen.text((x, position[1]), text, INK, font(size_px), anchor="lm")
    return x + pen.textlength(text, font(size_px)) + ENTRY_GAP_RATIO * size_px
