"""A sequence's page as its owner uses it: looking, moving along the drive, changing what is said of it."""

from typing import Any

import pytest
from playwright.sync_api import Page, expect

from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import PATIENCE_MS, Site
from tests.web.looking import look
from tests.web.sequence_world import CAMERAS, FRAMES, playback, whole_sequence

RIG = ["front left", "front", "front right", "back left", "back", "back right"]


@pytest.fixture
def shown(platform: Platform, curator: Person) -> dict[str, Any]:
    return whole_sequence(platform, curator)


def to(page: Page, shown: dict[str, Any], section: str = "") -> None:
    answer = page.goto(f"/sequences/{shown['id']}{section}")
    assert answer is not None
    assert answer.status == 200


def test_the_overview_says_what_came_of_it_in_pictures_and_figures(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to(page, shown)
        expect(page.get_by_role("heading", level=1)).to_have_text("rolling-meadow")
        expect(page.locator(".figure").first).to_contain_text(str(FRAMES))
        expect(page.get_by_text("LAB-603")).to_be_visible()
        expect(page.locator("[data-viewer]")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
        expect(page.get_by_role("link", name="frames.parquet")).to_be_visible()
        look(page, "sequence")


def test_findings_are_graded_by_harm_and_each_leads_to_the_page_of_its_code(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to(page, shown)
        harmful, harmless = page.locator(".finding", has_text="LAB-603"), page.locator(".finding", has_text="TIM-201")
        expect(harmful).to_contain_text("labels may be wrong")
        expect(harmless).not_to_be_visible()
        page.get_by_text("1 without effect on the labels").click()
        expect(harmless).to_contain_text("labels unaffected")
        colour = "one => getComputedStyle(one).borderLeftColor"
        assert harmful.evaluate(colour) != harmless.evaluate(colour)
        look(page, "sequence-findings")
        harmful.get_by_role("link", name="LAB-603").click()
        expect(page).to_have_url(f"{site.url}/codes/LAB-603")
        expect(page.get_by_role("heading", level=1)).to_have_text("LAB-603")


def test_somebody_moves_along_the_frames_by_keys_and_all_pictures_follow(
    site: Site, platform: Platform, curator: Person, shown: dict[str, Any]
) -> None:
    playback(platform, shown)
    tokens = shown["tokens"]
    with site.visit(curator) as page:
        to(page, shown, f"/frames?frame={tokens[3]}")
        assert page.locator(".frame-cameras figcaption").all_inner_texts() == RIG
        slider = page.get_by_role("slider", name="Frame")
        expect(slider).to_have_value("3")
        slider.press("ArrowRight")
        for channel in CAMERAS:
            expect(page.locator(f"[data-camera={channel}]")).to_have_attribute(
                "src", f"/api/v1/frames/{tokens[4]}/camera/{channel}.jpg?v={shown['label_set_id']}"
            )
        expect(page.locator("[data-bev]")).to_have_js_property("naturalWidth", 512)
        slider.press("End")
        expect(page).to_have_url(f"{site.url}/sequences/{shown['id']}/frames?frame={tokens[-1]}")
        expect(page.get_by_role("link", name="This frame in 3D")).to_have_attribute(
            "href", f"/sequences/{shown['id']}/view?frame={tokens[-1]}"
        )
        slider.press("PageDown")
        expect(slider).to_have_value(str(FRAMES - 11))
        slider.press("Space")
        expect(page.get_by_role("button", name="Pause")).to_be_visible()
        expect(slider).to_have_value(str(FRAMES - 1))
        expect(page.get_by_role("button", name="Play")).to_be_visible()
        look(page, "sequence-frames")


def test_without_pictures_the_owner_has_them_made_and_they_are_asked_for_once(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to(page, shown, "/frames")
        page.get_by_role("button", name="Extract images").click()
        expect(page.get_by_text("images are being prepared")).to_be_visible()
        look(page, "sequence-frames-making")


def test_the_track_tells_where_and_how_fast_at_every_moment(site: Site, curator: Person, shown: dict[str, Any]) -> None:
    with site.visit(curator) as page:
        to(page, shown, "/track")
        expect(page.get_by_text("north is up")).to_be_visible()
        slider = page.get_by_role("slider", name="Position along the track")
        slider.focus()
        slider.press("ArrowRight")
        expect(page.locator("[data-said]")).to_contain_text("0.1 s")
        expect(page.locator("[data-robot]")).to_have_attribute("visibility", "visible")
        expect(page.get_by_role("link", name="Open frame")).to_have_attribute(
            "href", f"/sequences/{shown['id']}/frames?frame={shown['tokens'][1]}"
        )
        look(page, "sequence-track")
        page.get_by_text("2 excluded sweeps").click()
        expect(page.get_by_role("cell", name="SYN-504", exact=True)).to_be_visible()


def test_a_recording_shows_its_gaps_its_clocks_and_how_good_it_is(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to(page, shown, "/recordings")
        expect(page.get_by_role("img", name="Quality 78 of 100")).to_be_visible()
        radar = page.get_by_role("row", name="/radar").filter(has_text="TAI-UTC")
        expect(radar).to_contain_text("−37 s")
        expect(radar.locator(".clock-dot").first).to_have_attribute("data-tone", "bad")
        expect(page.locator(".spoke-gap")).to_have_count(1)
        shifted = page.get_by_role("row", name="cameras.mcap")
        expect(shifted).to_contain_text("-0.080000 s")
        expect(shifted).to_contain_text("0.41 ms")
        expect(shifted).to_contain_text("camera motion")
        look(page, "sequence-recordings")


def test_calibration_and_processing_and_exports_are_whole_pages(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to(page, shown, "/calibration")
        assert page.locator(".overlays figcaption").all_inner_texts() == RIG
        look(page, "sequence-calibration")
        to(page, shown, "/processing")
        expect(page.get_by_role("heading", name="Labelling")).to_be_visible()
        look(page, "sequence-processing")
        to(page, shown, "/exports")
        page.get_by_role("button", name="Create Mesh").click()
        expect(page.locator(".export-list")).to_contain_text("queued")
        look(page, "sequence-exports")


def test_the_owner_edits_shares_and_deletes_it(site: Site, curator: Person, shown: dict[str, Any]) -> None:
    with site.visit(curator) as page:
        to(page, shown)
        page.get_by_role("button", name="Edit").click()
        expect(page.get_by_role("textbox", name="Name fixed")).to_be_disabled()
        page.get_by_label("Environment").select_option("lake")
        page.get_by_role("button", name="Save").click()
        expect(page.locator(".sequence-head")).to_contain_text("lake")
        page.get_by_role("button", name="Make public").click()
        dialog = page.get_by_role("dialog", name="Make it public")
        dialog.get_by_role("button", name="Make public").click()
        expect(page.locator(".sequence-head")).to_contain_text("public")
        with site.visit() as visitor:
            to(visitor, shown)
            to(visitor, shown, "/frames")
            assert visitor.locator(".tabs a").all_inner_texts() == [
                "Overview",
                "Frames",
                "Track",
                "Calibration",
                "Exports",
            ]
        page.get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        expect(page).to_have_url(f"{site.url}/sequences")
