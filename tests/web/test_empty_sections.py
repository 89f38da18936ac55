"""A section without content is empty for good or for now: it offers work only if the work can fill it."""

from typing import Any

import pytest
from sqlalchemy import delete

from services.domain.exports.requests import follow_labels
from services.domain.viewer.playback import INDEX, PLAYBACK, PlaybackChannels, index_record
from services.runtime.orm import LabelSet, Preview, Recording, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.web.reading import Reading
from testing.worlds import made
from testing.worlds.frame_tables import frame_table_bytes
from tests.web.looking import look
from tests.web.sequence_world import inspection, replace_files, whole_sequence
from tests.web.test_pages import new_sequence
from tests.web.test_sequence_page import to


@pytest.fixture
def blind(platform: Platform, curator: Person) -> dict[str, Any]:
    """A labelled run of a robot without cameras."""
    shown = whole_sequence(platform, curator)
    table = frame_table_bytes(shown["tokens"], made.START_NS, cameras=())
    replace_files(platform, shown["label_set_id"], {"frames.parquet": table})
    without_overlays(platform, shown["id"])
    return shown


def without_overlays(platform: Platform, sequence_id: str) -> None:
    with platform.database.transaction() as session:
        session.execute(delete(Preview).where(Preview.sequence_id == sequence_id, Preview.recording_id.is_(None)))


def test_a_run_without_cameras_is_not_offered_camera_images(
    site: Site, platform: Platform, curator: Person, blind: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        for has_playback in (False, True):
            if has_playback:
                made.export(platform, blind["id"], {INDEX: index_record(PlaybackChannels((), True))}, PLAYBACK)
            to(page, blind, "/frames")
            assert page.get_by_role("heading", name="No cameras").is_visible()
            assert page.get_by_role("button", name="Extract images").count() == 0
        look(page, "frames-without-cameras")
        to(page, blind, "/calibration")
        assert page.get_by_role("heading", name="No cameras").is_visible()
        assert page.get_by_text("No overlay yet").count() == 0


def test_a_playback_without_pictures_is_not_offered_again(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    """The frames have cameras, but none whose pictures could be shown: another try ends the same."""
    shown = whole_sequence(platform, curator)
    assert "Extract images" in reading.html(f"/sequences/{shown['id']}/frames", curator)
    made.export(platform, shown["id"], {INDEX: index_record(PlaybackChannels((), True))}, PLAYBACK)
    assert "Extract images" not in reading.html(f"/sequences/{shown['id']}/frames", curator)


@pytest.mark.parametrize("channels", [{"lidar": "/lidar"}, {"lidar": "/lidar", "CAM_FRONT": "/front"}])
def test_before_it_is_labelled_an_overlay_is_promised_only_if_the_recording_has_cameras(
    reading: Reading, platform: Platform, curator: Person, channels: dict[str, str]
) -> None:
    shown = new_sequence(platform, curator)
    with platform.database.transaction() as session:
        row = Recording(sequence_id=shown["id"], filename="run.mcap", size_bytes=3, sha256="0" * 64)
        row.state, row.inspection = "registered", {**inspection(), "channels": channels}
        session.add(row)
    html = reading.html(f"/sequences/{shown['id']}/calibration", curator)
    assert ("No overlay yet" in html) is ("CAM_FRONT" in channels)
    assert ("No cameras" in html) is ("CAM_FRONT" not in channels)


def test_labels_whose_run_wrote_no_overlay_are_not_promised_one(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    shown = whole_sequence(platform, curator)
    without_overlays(platform, shown["id"])
    assert "No overlay yet" not in reading.html(f"/sequences/{shown['id']}/calibration", curator)


def test_images_for_the_viewer_that_nobody_asked_for_are_no_export(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    shown = whole_sequence(platform, curator)
    with platform.database.transaction() as session:
        sequence = session.get_one(SequenceRow, shown["id"])
        follow_labels(session, sequence, session.get_one(LabelSet, shown["label_set_id"]), PLAYBACK)
    for finished in (False, True):
        if finished:
            made.export(platform, shown["id"], {"mesh.ply": b"ply"})
        html = reading.html(f"/sequences/{shown['id']}/exports", curator)
        assert "playback" not in html
        assert html.count('<li class="card">') == int(finished)
        assert "Export the labels" not in reading.html(f"/sequences/{shown['id']}", curator)
