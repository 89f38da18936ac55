"""Previews written by `stone label --previews` and by the platform beside a sequence's labels.

| file | shows | media type |
|---|---|---|
| film.mp4, film.gif | the sequence, cameras around the labels | video/mp4, image/gif |
| sheet.jpg | the middle frame, as in the film | image/jpeg |
| plan.png, oblique.png | the labels of the middle frame from above, and in perspective | image/png |
| map.png, features.png | the whole map in perspective; its elevation, slope and roughness | image/png |

The last two are made from the map's tiles while these exist, the others from a labelled sequence at any time.
"""

import io
from pathlib import Path

from PIL import Image

from services.labeler.exports.source import LabelledSequence
from services.labeler.previews.feature_maps import write_feature_maps
from services.labeler.previews.film import GIF, MP4, write_film
from services.labeler.previews.map_pieces import Pieces
from services.labeler.previews.map_view import write_map_oblique
from services.labeler.previews.sheet import frame_pictures
from services.labeler.run import Step, silent
from stone.geometry.se3 import SE3
from stone_files.atomic import atomic_file

SHEET, PLAN, OBLIQUE, MAP, FEATURES = "sheet.jpg", "plan.png", "oblique.png", "map.png", "features.png"
MEDIA_TYPES = {MP4: "video/mp4", GIF: "image/gif", SHEET: "image/jpeg"} | dict.fromkeys(
    (PLAN, OBLIQUE, MAP, FEATURES), "image/png"
)
JPEG_QUALITY = 85


def write_previews(source: LabelledSequence, out: Path, step: Step = silent) -> None:
    """Write the first five into the folder `out`; a sequence has at least one frame. Raises what the source raises."""
    pictures = frame_pictures(source, len(source.sequence.frames) // 2)
    _write(out / SHEET, jpeg_bytes(pictures.sheet))
    _write(out / PLAN, png_bytes(pictures.plan))
    _write(out / OBLIQUE, png_bytes(pictures.oblique))
    write_film(source, out, step)


def write_map_previews(pieces: Pieces, map_from_ego: SE3, out: Path, profile: str = "paper") -> None:
    """Write the last two into the folder `out`; `map_from_ego` (P,) are the poses of the track."""
    write_map_oblique(pieces, map_from_ego, out / MAP)
    write_feature_maps(pieces, map_from_ego, out / FEATURES, profile)


def png_bytes(picture: Image.Image) -> bytes:
    """Return the picture as a PNG, for labels with sharp edges."""
    file = io.BytesIO()
    picture.save(file, "PNG", optimize=True)
    return file.getvalue()


def jpeg_bytes(picture: Image.Image) -> bytes:
    """Return the picture as a JPEG, for camera images."""
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=JPEG_QUALITY, optimize=True)
    return file.getvalue()


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path) as staging:
        staging.write_bytes(content)
