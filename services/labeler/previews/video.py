"""Pictures in a row as a film: MP4 (H.264, what every browser plays) and GIF (what every page shows).

**Conventions.** One picture is in memory at a time. One thread, nothing of the date or the machine in the files: equal
pictures give equal bytes under one version of the encoders.
"""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.video.stream import VideoStream
from PIL import Image

CODEC, PIXELS = "libx264", "yuv420p"
# Six more in crf halve the bytes; x264's own default is 23. `faststart` puts the index first: it plays while it loads.
QUALITY = {"crf": "27", "preset": "veryfast", "threads": "1"}
CONTAINER = {"movflags": "+faststart", "fflags": "+bitexact"}
GIF_COLOURS = 96


class Mp4:
    """An MP4 that frames are added to; a context. Sides are even; `rate_hz` whole frames a second."""

    def __init__(self, path: Path, size_px: tuple[int, int], rate_hz: int) -> None:
        self._container = av.open(str(path), "w", format="mp4", options=CONTAINER)
        stream = cast("VideoStream", self._container.add_stream(CODEC, rate=rate_hz, options=QUALITY))
        stream.width, stream.height = size_px
        stream.pix_fmt = PIXELS
        stream.thread_count = 1
        stream.codec_context.time_base = Fraction(1, rate_hz)
        self._stream, self._shown = stream, 0

    def __enter__(self) -> "Mp4":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._container.mux(self._stream.encode(None))
        finally:
            self._container.close()

    def add(self, picture: Image.Image) -> None:
        """Show this next."""
        frame = av.VideoFrame.from_ndarray(np.asarray(picture.convert("RGB")), format="rgb24")
        frame.pts, frame.time_base = self._shown, self._stream.codec_context.time_base
        self._shown += 1
        self._container.mux(self._stream.encode(frame))


def write_gif(path: Path, pictures: Iterable[Image.Image], palette: Image.Image, frame_ms: int) -> None:
    """The pictures, all of one size, in the colours of `palette` (of mode P); there is at least one."""
    frames = _quantized(pictures, palette)
    first = next(frames)
    first.save(path, "GIF", save_all=True, append_images=frames, duration=frame_ms, loop=0, optimize=False)


def gif_palette(pictures: list[Image.Image], kept: list[tuple[int, int, int]]) -> Image.Image:
    """The colours that serve all of these pictures, and those `kept` exactly."""
    tops = np.cumsum([0, *(picture.height for picture in pictures)])
    sample = Image.new("RGB", (max(picture.width for picture in pictures), int(tops[-1])))
    for picture, top in zip(pictures, tops, strict=False):
        sample.paste(picture, (0, int(top)))
    found = sample.quantize(GIF_COLOURS - len(kept), Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*sum(kept, ()), *(found.getpalette() or [])])
    return palette


def _quantized(pictures: Iterable[Image.Image], palette: Image.Image) -> Iterator[Image.Image]:
    for picture in pictures:
        yield picture.quantize(palette=palette, dither=Image.Dither.NONE)
