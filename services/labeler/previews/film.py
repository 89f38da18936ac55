"""`film.mp4` and `film.gif`: the sequence as sheets of cameras and labels, at most half a minute long."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.video.stream import VideoStream
from PIL import Image

from services.labeler.exports.source import LabelledSequence
from services.labeler.previews.sheet import ABOVE, BELOW, cell_ratio, frame_sheet, sheet_size
from services.labeler.run import Step, silent
from stone.labels.class_colours import CLASS_RGB, INK, PAPER, TRACK, UNSEEN
from stone_files.atomic import atomic_file

MP4, GIF = "film.mp4", "film.gif"
RATE_HZ, MOST_FRAMES = 10, 300
GIF_WIDTH_PX, MOST_GIF_FRAMES = 480, 100
PALETTE_FROM = 4
SHADES = (1.0, 0.84, 0.72)


@dataclass(frozen=True)
class _Reel:
    """The frames in both films; the GIF has every `gif_every`-th of them."""

    indices: range
    gif_every: int
    ratio: float


def write_film(source: LabelledSequence, out: Path, step: Step = silent) -> None:
    """Write both into the folder `out`: every n-th frame, so that a film lasts at most `MOST_FRAMES / RATE_HZ` s.

    Raises what the source raises.
    """
    reel = _reel_of(source)
    step(0, len(reel.indices))
    palette = gif_palette([_small(picture) for picture in _spread(source, reel)], _kept_colours())
    with atomic_file(out / MP4) as mp4, atomic_file(out / GIF) as gif:
        frame_ms = round(1000 * reel.gif_every / RATE_HZ)
        write_gif(gif, _write_frames(source, reel, mp4, step), palette, frame_ms)


def _kept_colours() -> list[tuple[int, int, int]]:
    """Return the legend's colours, which must be exact in light and in shade."""
    lit = [(colour, light) for colour in (*CLASS_RGB.values(), TRACK) for light in SHADES]
    shaded = [(round(r * light), round(g * light), round(b * light)) for (r, g, b), light in lit]
    return [PAPER, INK, UNSEEN, *shaded]


def _reel_of(source: LabelledSequence) -> _Reel:
    total = len(source.sequence.frames)
    indices = range(0, total, -(-total // MOST_FRAMES))
    first = (source.samples.camera(channel, 0) for channel in (*ABOVE, *BELOW))
    return _Reel(indices, -(-len(indices) // MOST_GIF_FRAMES), cell_ratio(first))


def _spread(source: LabelledSequence, reel: _Reel) -> Iterator[Image.Image]:
    """Yield a few frames from all parts of the sequence."""
    for index in reel.indices[:: max(1, len(reel.indices) // PALETTE_FROM)]:
        yield frame_sheet(source, index, reel.ratio)


def _write_frames(source: LabelledSequence, reel: _Reel, path: Path, step: Step) -> Iterator[Image.Image]:
    """Write the film to `path`; yield the small pictures of the GIF on the way."""
    with Mp4(path, sheet_size(reel.ratio), RATE_HZ) as film:
        for number, index in enumerate(reel.indices):
            picture = frame_sheet(source, index, reel.ratio)
            film.add(picture)
            if number % reel.gif_every == 0:
                yield _small(picture)
            step(number + 1, len(reel.indices))


def _small(picture: Image.Image) -> Image.Image:
    height = round(picture.height * GIF_WIDTH_PX / picture.width)
    return picture.resize((GIF_WIDTH_PX, height), Image.Resampling.BOX)


# Consecutive pictures as a film: MP4 (H.264, for every browser) and GIF (for every page). One picture is in memory at a
# time. One thread, and neither date nor machine in the files, so equal pictures give equal bytes with the same encoder
# version.


CODEC, PIXELS = "libx264", "yuv420p"
# Six more in crf halve the bytes; x264's own default is 23. `faststart` puts the index first, for progressive playback.
QUALITY = {"crf": "27", "preset": "veryfast", "threads": "1"}
CONTAINER = {"movflags": "+faststart", "fflags": "+bitexact"}
GIF_COLOURS = 96


class Mp4:
    """An MP4 to which frames are added; a context manager. Sides are even; `rate_hz` whole frames a second."""

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
        """Add the next picture."""
        frame = av.VideoFrame.from_ndarray(np.asarray(picture.convert("RGB")), format="rgb24")
        frame.pts, frame.time_base = self._shown, self._stream.codec_context.time_base
        self._shown += 1
        self._container.mux(self._stream.encode(frame))


def write_gif(path: Path, pictures: Iterable[Image.Image], palette: Image.Image, frame_ms: int) -> None:
    """Write the pictures, all of one size, in the colours of `palette` (of mode P); there is at least one."""
    frames = _quantize(pictures, palette)
    first = next(frames)
    first.save(path, "GIF", save_all=True, append_images=frames, duration=frame_ms, loop=0, optimize=False)


def gif_palette(pictures: list[Image.Image], kept: list[tuple[int, int, int]]) -> Image.Image:
    """Return a palette that suits all these pictures and contains the colours `kept` exactly."""
    tops = np.cumsum([0, *(picture.height for picture in pictures)])
    sample = Image.new("RGB", (max(picture.width for picture in pictures), int(tops[-1])))
    for picture, top in zip(pictures, tops, strict=False):
        sample.paste(picture, (0, int(top)))
    quantized = sample.quantize(GIF_COLOURS - len(kept), Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*sum(kept, ()), *(quantized.getpalette() or [])])
    return palette


def _quantize(pictures: Iterable[Image.Image], palette: Image.Image) -> Iterator[Image.Image]:
    for picture in pictures:
        yield picture.quantize(palette=palette, dither=Image.Dither.NONE)
