"""Safe decoding of camera images of unknown origin."""

import io

from PIL import Image

from stone.sensors.samples import CameraSample

MOST_PIXELS = 1 << 26


def opened(sample: CameraSample | None, size_px: tuple[int, int]) -> Image.Image | str:
    """Return the picture, reduced to no less than `size_px`, or the reason why it is missing."""
    if sample is None:
        return "no picture"
    if sample.width_px * sample.height_px > MOST_PIXELS:
        return "picture too large"
    try:
        picture = Image.open(io.BytesIO(sample.content), formats=["JPEG"])
        picture.draft("RGB", size_px)
        return picture.convert("RGB")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning):
        return "picture cannot be read"
