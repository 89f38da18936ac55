"""The label sets of a sequence in a browser: one is compared with another, and what differs is shown."""

from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds import made
from testing.worlds.benchmark_world import Grid, labels_npz, run_eval
from tests.web.looking import look
from tests.web.sequence_world import whole_sequence


@pytest.fixture
def shown(platform: Platform, curator: Person) -> dict[str, Any]:
    return whole_sequence(platform, curator)


def band(kind: int, from_y: int) -> Grid:
    """Ground around the robot, T, and ahead of it a band of this class."""
    grid = np.zeros((256, 256, 32), np.uint8)
    grid[64:192, 64:192, 9] = 1
    grid[150:180, from_y:180, 9] = kind
    return grid


def to_label_sets(page: Page, shown: dict[str, Any]) -> None:
    page.goto(f"/sequences/{shown['id']}/label-sets")


def test_with_one_label_set_the_page_says_how_a_second_comes(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to_label_sets(page, shown)
        expect(page.get_by_text("A second label set appears when")).to_be_visible()
        expect(page.get_by_role("button", name="Compare")).to_have_count(0)
        look(page, "sequence-label-sets-empty")


def test_the_owner_compares_two_label_sets_and_sees_what_differs(
    site: Site, platform: Platform, curator: Person, shown: dict[str, Any]
) -> None:
    for seed, kind in ((b"one", 3), (b"other", 2)):
        made.labels(platform, shown, contents=[labels_npz(band(kind, 90 + kind))] * 2, seed=seed)
    with site.visit(curator) as page:
        to_label_sets(page, shown)
        page.get_by_role("button", name="Compare").click()
        card = page.get_by_role("region", name="A and B compared")
        expect(card).to_contain_text("queued")
        run_eval(platform)
        page.reload()
        expect(card).to_contain_text("Frames in both")
        expect(page.get_by_role("row", name="0 m to 10 m")).to_be_visible()
        expect(page.get_by_role("img", name="Confusion")).to_be_visible()
        picture = page.get_by_role("img", name="in A, in B").first
        picture.scroll_into_view_if_needed()
        expect(picture).to_have_js_property("naturalWidth", 1568)
        look(page, "sequence-label-sets")
