"""The 3D view of two label sets: how their voxels differ, frame by frame, beside the arrays they were made of."""

from dataclasses import dataclass

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from services.domain.viewer.indexed_pictures import DIFFERENCE_RGB
from services.runtime.platform import Platform
from stone.labels.class_colours import CLASS_RGB
from stone.scoring.agreement import DIFFERENCES, SAME, differences
from testing.api.serving import Person
from testing.web.browsing import PATIENCE_MS, Site
from testing.worlds import made
from testing.worlds.benchmark_world import Grid, labels_npz
from testing.worlds.viewer_world import Run, viewed
from tests.web.looking import look
from tests.web.test_viewer_data import IMPORTS

RUN = Run(frames=2, reach_m=3.0)
SAME_RGB, T_RGB = list(DIFFERENCE_RGB[SAME]), list(CLASS_RGB[1])  # tokens --same and --t of the light page


@dataclass(frozen=True)
class Pair:
    """A run that was labelled twice: what counts, B, and before it A; the page that shows how they differ."""

    sequence_id: str
    comparison_id: str
    tokens: tuple[str, ...]
    a: Grid
    b: Grid

    @property
    def page(self) -> str:
        return f"/sequences/{self.sequence_id}/view?frame={self.tokens[0]}&compare={self.comparison_id}"


def changed(grid: Grid) -> Grid:
    """Of every class a part is free, and a part of another class; something stands where nothing was."""
    other = np.where(np.random.default_rng(5).random(grid.shape) < 0.3, grid % 3 + 1, grid).astype(np.uint8)
    other[grid == 0] = 0
    other[:, :120] = 0
    other[100:104, 126:130, 20:22] = 3
    return other


@pytest.fixture
def pair(platform: Platform, curator: Person) -> Pair:
    facts = viewed(platform, curator, RUN)
    b, a = RUN.grids[0], changed(RUN.grids[0])
    earlier = made.labels(platform, facts, contents=[labels_npz(a), labels_npz(a)], seed=b"earlier")
    comparison_id = made.label_comparison(platform, facts["id"], (earlier.id, facts["label_set_id"]))
    return Pair(facts["id"], comparison_id, tuple(facts["tokens"]), a, b)


def legend(page: Page) -> dict[str, str]:
    rows = page.locator(".viewer-legend li")
    return {row.locator("span").first.inner_text(): row.locator(".viewer-share").inner_text() for row in rows.all()}


def painted_first(page: Page) -> list[int]:
    """The colour of the palette's first entry, which is traversable, or no difference."""
    script = f"""async () => {{ {IMPORTS}
    const viewer = (await load("mount")).viewerOf(document.querySelector("[data-viewer]"));
    return [...viewer.world.paint.palette.image.data.slice(4, 7)]; }}"""
    found: list[int] = page.evaluate(script)
    return found


def test_the_codes_decode_to_how_the_voxels_differ(site: Site, curator: Person, pair: Pair) -> None:
    script = f"""async address => {{ {IMPORTS}
    const {{ planesOf, coded, codeAt }} = await load("data/formats");
    const planes = planesOf(await fetched(address), "STD1");
    return [...coded(planes)].map(index => [index, codeAt(planes, index)]); }}"""
    with site.visit(curator) as page:
        page.goto("/sign-in", wait_until="domcontentloaded")
        address = f"/api/v1/sequences/{pair.sequence_id}/label-comparisons/{pair.comparison_id}/frames"
        found = page.evaluate(script, f"{address}/{pair.tokens[0]}/voxels")
    codes = differences(pair.a, pair.b).ravel()
    at = np.flatnonzero(codes)
    np.testing.assert_array_equal(found, np.stack([at, codes[at]], axis=1))


def test_differences_are_shown_with_their_shares_and_classes_when_asked_for(
    site: Site, curator: Person, pair: Pair
) -> None:
    with site.visit(curator) as page:
        page.goto(pair.page)
        expect(page.locator("[data-viewer]")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
        expect(page.get_by_label("Colour by")).to_have_value("difference")
        codes = differences(pair.a, pair.b)
        counts = np.bincount(codes[codes > 0], minlength=len(DIFFERENCES))[1:]
        shares = [f"{round(100 * count / counts.sum())} %" for count in counts]
        assert list(legend(page).values()) == shares
        assert list(legend(page)) == [
            "The same class", "Only in A", "Only in B", "More traversable in B", "Less traversable in B",
        ]  # fmt: skip
        assert painted_first(page) == SAME_RGB
        look(page, "viewer-differences")
        page.get_by_label("Colour by").select_option("class")
        expect(page.locator(".viewer-legend li").first).to_contain_text("Traversable")
        assert painted_first(page) == T_RGB
        page.get_by_label("Colour by").select_option("difference")
        expect(page.locator(".viewer-legend li").first).to_contain_text("The same class")
        page.get_by_label("Show", exact=True).select_option("map")
        expect(page.get_by_label("Colour by")).to_have_value("class")


def test_a_voxel_that_is_picked_says_how_it_differs(site: Site, curator: Person, pair: Pair) -> None:
    with site.visit(curator) as page:
        page.goto(pair.page)
        expect(page.locator("[data-viewer]")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
        page.get_by_role("application").focus()
        page.keyboard.press("c")
        page.keyboard.press("Shift+ArrowDown")
        expect(page.locator(".viewer-readout h3")).to_be_visible()
        assert page.locator(".viewer-readout h3").inner_text().strip() in (
            "The same class", "Only in A", "Only in B", "More traversable in B", "Less traversable in B",
        )  # fmt: skip
