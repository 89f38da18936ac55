"""Films and sheets, opened again by PyAV and Pillow."""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from services.labeler.previews import film
from services.labeler.previews.film import write_film
from services.labeler.previews.preview_files import MEDIA_TYPES, write_previews
from services.labeler.previews.sheet import BLANK, CAMERA_PX, GAP_PX, PLAN_PX, WIDTH_PX, frame_pictures, frame_sheet
from tests.services.labeler.previews.sources import COLOURS, SIZE_PX, Pictures, source_of

HIGH_PX = round(CAMERA_PX * SIZE_PX[1] / SIZE_PX[0]) // 2 * 2


def centre_of(channel: str) -> tuple[int, int]:
    """A place in the upper middle of a camera's cell."""
    place = list(COLOURS).index(channel)
    top = GAP_PX if place < 3 else 3 * GAP_PX + HIGH_PX + PLAN_PX
    return GAP_PX + place % 3 * (CAMERA_PX + GAP_PX) + CAMERA_PX // 2, top + HIGH_PX // 4


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    write_film(source_of(4), folder)
    return folder


def test_the_film_shows_every_frame_of_a_short_sequence_at_ten_a_second(written):
    with av.open(str(written / "film.mp4")) as container:
        (stream,) = container.streams
        frames = [frame.to_image() for frame in container.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (len(frames), float(stream.average_rate)) == (4, 10)
        assert float(stream.duration * stream.time_base) == pytest.approx(0.4)
    assert {frame.width for frame in frames} == {WIDTH_PX}
    assert frames[0].height == frame_sheet(source_of(4), 0).height
    for channel, colour in COLOURS.items():
        assert np.abs(np.array(frames[2].getpixel(centre_of(channel))) - colour).max() < 25, channel


def test_the_index_comes_first_so_that_a_browser_plays_while_it_loads(written):
    content = (written / "film.mp4").read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_the_gif_is_small_and_loops(written):
    with Image.open(written / "film.gif") as gif:
        assert (gif.n_frames, gif.width, gif.info["loop"]) == (4, 480, 0)
        assert gif.info["duration"] == 100
        sheet = frame_sheet(source_of(4), 0)
        assert gif.height == round(sheet.height * 480 / WIDTH_PX)


def test_the_same_sequence_gives_the_same_film(written, tmp_path):
    steps: list[tuple[int, int]] = []
    write_film(source_of(4), tmp_path, lambda *done: steps.append(done))
    for name in ("film.mp4", "film.gif"):
        assert (tmp_path / name).read_bytes() == (written / name).read_bytes(), name
    assert steps == [(done, 4) for done in range(5)]
    assert {path.name for path in tmp_path.iterdir()} == {"film.mp4", "film.gif"}


def test_of_a_long_sequence_every_nth_frame_is_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(film, "MOST_FRAMES", 3)
    monkeypatch.setattr(film, "MOST_GIF_FRAMES", 2)
    write_film(source_of(7), tmp_path)
    with av.open(str(tmp_path / "film.mp4")) as container:
        assert len(list(container.decode(video=0))) == 3  # frames 1, 4 and 7
    with Image.open(tmp_path / "film.gif") as gif:
        assert (gif.n_frames, gif.info["duration"]) == (2, 200)
    assert film.MOST_FRAMES / film.RATE_HZ <= 30


def test_a_camera_without_a_picture_leaves_a_blank_and_the_others_their_places():
    sheet = frame_sheet(source_of(2, Pictures(silent=("CAM_FRONT_LEFT", "CAM_BACK"), broken=("CAM_FRONT",))), 1)
    for channel, colour in COLOURS.items():
        is_blank = channel in ("CAM_FRONT_LEFT", "CAM_BACK", "CAM_FRONT")
        shown = sheet.getpixel(centre_of(channel))
        assert np.abs(np.array(shown) - (BLANK if is_blank else colour)).max() < 12, channel


def test_a_picture_too_large_to_decode_is_not_decoded(monkeypatch):
    monkeypatch.setattr("services.labeler.previews.picture_opening.MOST_PIXELS", SIZE_PX[0] * SIZE_PX[1] - 1)
    sheet = frame_sheet(source_of(2), 0)
    assert {sheet.getpixel(centre_of(channel)) for channel in COLOURS} == {BLANK}


def test_sheets_differ_from_frame_to_frame_and_not_from_time_to_time():
    source = source_of(3)
    first, second = frame_pictures(source, 0), frame_pictures(source, 1)
    assert first.sheet.tobytes() == frame_pictures(source, 0).sheet.tobytes()
    for name in ("plan", "oblique", "sheet"):
        assert getattr(first, name).tobytes() != getattr(second, name).tobytes()
    assert first.plan.size == (800, 800)


def test_all_previews_of_a_sequence_open_as_what_they_are_said_to_be(tmp_path):
    write_previews(source_of(3), tmp_path)
    for path in tmp_path.iterdir():
        kind = MEDIA_TYPES[path.name].split("/")[1]
        if kind == "mp4":
            continue
        with Image.open(path) as picture:
            assert picture.format == kind.upper()
    assert {path.name for path in tmp_path.iterdir()} == {
        "film.mp4", "film.gif", "sheet.jpg", "plan.png", "oblique.png",
    }  # fmt: skip


@pytest.mark.parametrize("broken", [0, 1])  # while the colours are chosen, while it is filmed
def test_a_film_that_breaks_off_leaves_nothing(tmp_path, broken):
    source = source_of(9)

    def labels(index: int) -> bytes:
        if index == broken:
            raise RuntimeError("the labels are gone")
        return source.labels(index)

    with pytest.raises(RuntimeError, match="the labels are gone"):
        write_film(replace(source, labels=labels), tmp_path)
    assert list(tmp_path.iterdir()) == []
