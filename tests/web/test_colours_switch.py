"""Class colours in a browser: everybody can tell the default apart, and whoever wants the paper's keeps them."""

import io
import re
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from services.runtime.platform import Platform
from stone.labels.class_colours import CLASS_RGB, PALETTES, hex_of
from testing.api.serving import Person
from testing.web.browsing import PATIENCE_MS, Site
from tests.web.listed_world import listed_world
from tests.web.looking import keep, look
from tests.web.sequence_world import playback, whole_sequence
from tests.web.test_viewer_differences import painted_first

PAPER = PALETTES["paper"]


@pytest.fixture
def shown(platform: Platform, curator: Person) -> dict[str, Any]:
    return whole_sequence(platform, curator)


def token_of(page: Page, name: str) -> str:
    found: str = page.evaluate("name => getComputedStyle(document.documentElement).getPropertyValue(name)", name)
    return found.strip()


def pixels_of(picture: Locator) -> NDArray[np.uint8]:
    """The picture as the page shows it, (H, W, 3)."""
    picture.scroll_into_view_if_needed()
    return np.asarray(Image.open(io.BytesIO(picture.screenshot())).convert("RGB"))


def has(pixels: NDArray[np.uint8], rgb: tuple[int, int, int]) -> bool:
    return bool((pixels == np.array(rgb)).all(axis=-1).any())


def test_the_paper_s_colours_are_chosen_once_and_kept(site: Site, curator: Person, shown: dict[str, Any]) -> None:
    base = f"/sequences/{shown['id']}"
    with site.visit(curator) as page:
        page.goto(f"{base}/frames")
        picture = page.locator("img[data-bev]")
        assert token_of(page, "--t") == hex_of(CLASS_RGB[1])
        assert has(pixels_of(picture), CLASS_RGB[1])
        choice = page.get_by_label("Class colours")
        choice.focus()
        page.keyboard.press("ArrowDown")
        expect(choice).to_have_value("paper")
        expect(picture).to_have_attribute("src", re.compile(r"[?&]colours=paper"))
        expect(picture).to_have_js_property("complete", True)
        assert token_of(page, "--t") == hex_of(PAPER[1])
        assert has(pixels_of(picture), PAPER[1])
        page.get_by_label("Next frame").click()
        expect(picture).to_have_attribute("src", re.compile(r"[?&]colours=paper"))
        page.reload()
        expect(page.get_by_label("Class colours")).to_have_value("paper")
        expect(picture).to_have_attribute("src", re.compile(r"&colours=paper"))
        assert token_of(page, "--n") == hex_of(PAPER[3])
        page.goto(f"{base}/view")
        expect(page.locator("[data-viewer]")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
        assert painted_first(page) == list(PAPER[1])
        page.get_by_label("Class colours").select_option("default")
        expect(page.locator("html")).not_to_have_attribute("data-colours", re.compile(".*"))
        assert painted_first(page) == list(CLASS_RGB[1])


def test_pictures_are_dark_on_a_dark_page(site: Site, curator: Person, shown: dict[str, Any]) -> None:
    """Catches alone a picture that brings a white ground along."""
    playback(site.platform, shown)
    with httpx.Client(base_url=site.url) as api:
        listed_world(site.platform, api, curator)
    base = f"/sequences/{shown['id']}"
    with site.visit(curator, color_scheme="dark") as page:
        for path, picture in (
            ("/sequences", ".sequence-card img"),
            (base, "img.uncut[data-coloured]"),
            (f"{base}/frames", "img[data-bev]"),
        ):
            page.goto(path)
            found = page.locator(picture).first
            found.scroll_into_view_if_needed()
            expect(found).not_to_have_js_property("naturalWidth", 0)
            expect(found).to_have_js_property("complete", True)
            pixels = pixels_of(found)
            assert np.median(pixels[2:8].max(axis=-1)) < 80, path
            assert has(pixels, CLASS_RGB[1]), path
            keep(page, f"colours-dark-{picture.split('[')[0].strip('.').replace(' ', '-')}")
        page.goto(f"{base}/frames")
        look(page, "colours-frames")
