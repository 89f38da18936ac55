"""Pictures of labels for pages: PNG files of one fixed palette, in which the class colours can be exchanged.

**Conventions.** A picture is an array (H, W) uint8 of indices into the palette. The ground is transparent, so a picture
is light on a light page and dark on a dark one; what was never seen is a translucent grey. Each class has nine
brightnesses for relief, chosen so that any two classes stay CIEDE2000 ≥ 25 apart under the three dichromacies. Since
the colours stand in one chunk (PLTE) of fixed length, `recoloured` exchanges it without decoding the picture.

Source: PNG 1.2 (RFC 2083), §4.1.2 (PLTE), §4.2.9 (tRNS).
"""

import io
import struct
import zlib
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from stone.labels.class_colours import INK, PALETTES, PAPER, TRACK, UNSEEN, ColourName
from stone.scoring.agreement import EASIER, HARDER, ONLY_A, ONLY_B, SAME

Indices = NDArray[np.uint8]

RELIEF, STEPS = 0.045, 4
LIGHTS = tuple(1.0 + RELIEF * step for step in range(-STEPS, STEPS + 1))
GROUND_INDEX, UNSEEN_INDEX, CASING_INDEX, TRACK_INDEX, ROBOT_INDEX = 0, 28, 29, 30, 31
DIFFERENCE_INDEX = 31
"""A difference's index is its code more than this."""
WORDS_INDEX, OPAQUE_INDEX = 40, 55
DIFFERENCE_RGB = {
    SAME: (189, 189, 184),
    ONLY_A: (86, 180, 233),
    ONLY_B: (230, 159, 0),
    EASIER: (150, 20, 20),
    HARDER: (20, 60, 150),
}
GREY, GREY_ALPHA, SAME_ALPHA, WORDS_RGB = (128, 132, 138), 90, 128, (112, 118, 126)
PALETTE_AT, PALETTE_BYTES = 41, 768


def lit(kinds: NDArray[np.uint8], steps: NDArray[np.float64]) -> Indices:
    """The indices of classes 0–3, brighter the more voxels the relief rises against the light, darker where it falls.

    `steps` has the shape of `kinds`; NaN is even ground.
    """
    light = np.clip(np.nan_to_num(steps), -STEPS, STEPS).astype(np.int16) + STEPS
    return np.where(kinds > 0, 1 + len(LIGHTS) * (kinds.astype(np.int16) - 1) + light, GROUND_INDEX).astype(np.uint8)


def of_class(kind: int) -> int:
    """The index of a class in even light."""
    return 1 + len(LIGHTS) * (kind - 1) + STEPS


def with_words(indices: Indices, mask: Image.Image) -> Indices:
    """What was written into the mask (mode "L", the picture's size) laid over the picture."""
    words = np.asarray(mask) // 16
    return np.where(words > 0, WORDS_INDEX + words, indices).astype(np.uint8)


def png_of(indices: Indices, compress_level: int = 3) -> bytes:
    """The picture as an indexed PNG in the default colours."""
    image, file = Image.fromarray(indices), io.BytesIO()
    image.putpalette(palette_bytes("default"))
    image.save(file, "PNG", transparency=ALPHAS, compress_level=compress_level)
    return file.getvalue()


def recoloured(png: bytes, colours: ColourName) -> bytes:
    """A picture of `png_of` with these class colours; any other file comes back as it is."""
    end = PALETTE_AT + PALETTE_BYTES
    if png[37:PALETTE_AT] != b"PLTE" or png[PALETTE_AT:end] not in {palette_bytes(name) for name in PALETTES}:
        return png
    palette = palette_bytes(colours)
    return png[:PALETTE_AT] + palette + struct.pack(">I", zlib.crc32(b"PLTE" + palette)) + png[end + 4 :]


def rgb_on_paper(indices: Indices) -> NDArray[np.uint8]:
    """The picture (H, W, 3) in the default colours on paper, for sheets and films."""
    return _on_paper()[indices]


@cache
def palette_bytes(colours: ColourName) -> bytes:
    """The 256 colours, RGB."""
    return _rgb(colours).tobytes()


@cache
def _rgb(colours: ColourName) -> NDArray[np.uint8]:
    table = np.full((256, 3), PAPER, np.uint8)  # also for readers that know no transparency
    for kind, colour in PALETTES[colours].items():
        lights = np.outer(LIGHTS, colour)
        first = of_class(kind) - STEPS
        table[first : first + len(LIGHTS)] = np.clip(np.round(lights), 0, 255)
    table[[UNSEEN_INDEX, CASING_INDEX, TRACK_INDEX, ROBOT_INDEX]] = GREY, PAPER, TRACK, INK
    for code, colour in DIFFERENCE_RGB.items():
        table[DIFFERENCE_INDEX + code] = GREY if code == SAME else colour
    table[WORDS_INDEX : OPAQUE_INDEX + 1] = WORDS_RGB
    return table


def _alphas() -> bytes:
    alphas = bytearray([255] * 256)
    alphas[GROUND_INDEX], alphas[UNSEEN_INDEX], alphas[DIFFERENCE_INDEX + SAME] = 0, GREY_ALPHA, SAME_ALPHA
    alphas[WORDS_INDEX : OPAQUE_INDEX + 1] = bytes(17 * step for step in range(OPAQUE_INDEX + 1 - WORDS_INDEX))
    return bytes(alphas)


ALPHAS = _alphas()
"""The opacity of the 256 colours, the same in every palette."""


@cache
def _on_paper() -> NDArray[np.uint8]:
    opacity = np.frombuffer(ALPHAS, np.uint8)[:, None] / 255.0
    table = np.round(_rgb("default") * opacity + np.array(PAPER) * (1.0 - opacity)).astype(np.uint8)
    table[[UNSEEN_INDEX, DIFFERENCE_INDEX + SAME]] = UNSEEN, DIFFERENCE_RGB[SAME]
    return table
