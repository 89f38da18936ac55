"""`film.mp4` and `film.gif`: the sequence as sheets of cameras and labels, at most half a minute long."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from services.labeler.exports.source import LabelledSequence
from services.labeler.previews.sheet import ABOVE, BELOW, cell_ratio, frame_sheet, sheet_size
from services.labeler.previews.video import Mp4, gif_palette, write_gif
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
    """Which frames are shown, in both films alike; `gif_every` of them one is in the GIF."""

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
        write_gif(gif, _filmed(source, reel, mp4, step), palette, frame_ms)


def _kept_colours() -> list[tuple[int, int, int]]:
    """What a legend explains must look the same everywhere, in light and in shade."""
    lit = [(colour, light) for colour in (*CLASS_RGB.values(), TRACK) for light in SHADES]
    shaded = [(round(r * light), round(g * light), round(b * light)) for (r, g, b), light in lit]
    return [PAPER, INK, UNSEEN, *shaded]


def _reel_of(source: LabelledSequence) -> _Reel:
    total = len(source.sequence.frames)
    indices = range(0, total, -(-total // MOST_FRAMES))
    first = (source.samples.camera(channel, 0) for channel in (*ABOVE, *BELOW))
    return _Reel(indices, -(-len(indices) // MOST_GIF_FRAMES), cell_ratio(first))


def _spread(source: LabelledSequence, reel: _Reel) -> Iterator[Image.Image]:
    """A few frames from all over the sequence."""
    for index in reel.indices[:: max(1, len(reel.indices) // PALETTE_FROM)]:
        yield frame_sheet(source, index, reel.ratio)


def _filmed(source: LabelledSequence, reel: _Reel, path: Path, step: Step) -> Iterator[Image.Image]:
    """Film into `path`; yields the small pictures that the GIF shows as they come."""
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
