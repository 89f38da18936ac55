"""The board at a browser: ties, one axis, sorting, its history, copies for papers, two entries against each other."""

import re

import pytest
from playwright.sync_api import FloatRect, Page, expect

from testing.web.browsing import Site
from tests.services.domain.benchmarks.boards import scene
from tests.web.boards_world import Season, publish, season
from tests.web.looking import look

METHODS = "tbody[data-standing='ranked'] .method .row > :first-child"
IN_ORDER: list[str | re.Pattern[str]] = ["TerrainFormer-L", "GroundNet++", "VoxTrav", "SurroundOcc-T", "RadarScout"]

BY_NAME: list[str | re.Pattern[str]] = ["GroundNet++", "RadarScout", "SurroundOcc-T", "TerrainFormer-L", "VoxTrav"]


@pytest.fixture
def board(site: Site) -> Season:
    return season(site.platform)


def boxes(page: Page, selector: str) -> list[FloatRect]:
    return [box for one in page.locator(selector).all() if (box := one.bounding_box())]


def test_a_visitor_sees_ties_in_a_bracket_and_intervals_on_one_axis(site: Site, board: Season) -> None:
    with site.visit() as page:
        page.goto(board.path)
        expect(page.locator(METHODS)).to_have_text(IN_ORDER)
        tied = page.locator("td.is-tied")
        assert tied.get_attribute("rowspan") == "2"
        assert page.locator("tr", has=tied).locator(".method").inner_text().startswith("GroundNet++")
        assert len({(box["x"], box["width"]) for box in boxes(page, ".whisker-plot")}) == 1
        rules = [box["x"] for box in boxes(page, "tr:first-child .whisker-plot .rule")][:3]
        assert [box["x"] + box["width"] / 2 for box in boxes(page, ".whisker-head text")][:3] == pytest.approx(
            rules, abs=1
        )
        values = [box["x"] for box in boxes(page, "tbody[data-standing='ranked'] .whisker-plot .value")]
        assert values == sorted(values, reverse=True)
        expect(page.locator("tbody[data-standing='reported'] .by").first).to_have_text(re.compile("Table II"))
        printed = page.locator("tbody[data-standing='reported'] tr", has_text="OccFormer")
        expect(printed.locator(".by")).to_have_text(re.compile("Table II.*note 1"))
        note = page.locator("tbody[data-standing='reported'] .group-notes")
        expect(note).to_have_text(re.compile("Note 1.*not comparable with a score on other data"))
        expect(page.locator("tr", has_text="CONet").locator("sup")).to_have_count(0)
        expect(printed.locator("td.number")).to_have_text(["24.3", "41.0", "31.0", "20.0", "22.0"])
        assert page.locator("tbody:not([data-standing='ranked']) td.rank strong").count() == 0
        look(page, "board")


def test_sorting_by_a_class_moves_rows_and_no_rank(site: Site, board: Season) -> None:
    with site.visit(board.member) as page:
        page.goto(board.path)
        page.get_by_role("link", name="Method").click()
        expect(page.locator(METHODS)).to_have_text(BY_NAME)
        expect(page.locator("tbody[data-standing='ranked'] td.rank strong")).to_have_text(["2", "5", "4", "1", "3"])
        expect(page.locator("td.is-tied")).to_have_count(0)
        expect(page.locator("th[aria-sort]")).to_have_text(re.compile("Method"))
        expect(page.locator("tr.is-yours")).to_contain_text("yours")
        page.get_by_role("link", name="Sort by rank").click()
        page.get_by_role("link", name="All entries").click()
        expect(page.locator(METHODS)).to_have_count(6)
        page.get_by_role("link", name="R", exact=True).click()
        expect(page.locator(METHODS)).to_have_text(["RadarScout"])


def test_the_slider_shows_the_board_as_it_stood(site: Site, board: Season) -> None:
    with site.visit() as page:
        page.goto(board.path)
        page.get_by_text("History", exact=True).click()
        slider = page.get_by_label("Leaderboard as of", exact=True)
        slider.focus()
        page.keyboard.press("Home")
        expect(page.get_by_role("heading", name="No entries yet")).to_be_visible()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        expect(page.locator(METHODS)).to_have_text(["RadarScout"])
        expect(page).to_have_url(re.compile("as_of="))
        expect(slider).to_be_focused()
        assert "1 row added" in (slider.get_attribute("aria-valuetext") or "")
        look(page, "board-history")
        page.reload()
        expect(page.locator(METHODS)).to_have_text(["RadarScout"])
        page.get_by_label("Leaderboard as of", exact=True).press("End")
        expect(page.locator(METHODS)).to_have_text(IN_ORDER)


@pytest.mark.parametrize("has_clipboard", [True, False])
def test_the_table_is_copied_for_a_paper(site: Site, board: Season, has_clipboard: bool) -> None:
    with site.visit(permissions=["clipboard-read", "clipboard-write"]) as page:
        if not has_clipboard:
            page.add_init_script("delete Navigator.prototype.clipboard")
        page.goto(board.path)
        page.get_by_role("button", name="Copy LaTeX").click()
        expect(page.locator("#toasts")).to_contain_text("LaTeX copied")
        page.evaluate("document.body.append(Object.assign(document.createElement('textarea'), {id: 'here'}))")
        page.locator("#here").press("Control+V")
        copied = page.locator("#here").input_value()
        assert copied == page.request.get(page.locator("a", has_text="LaTeX").get_attribute("href") or "").text()
        assert r"\toprule" in copied


def test_two_entries_picked_from_the_board_are_compared_in_words(site: Site, board: Season) -> None:
    with site.visit() as page:
        page.goto(board.path)
        page.get_by_role("button", name="Compare").click()
        expect(page.locator("[data-picked]")).to_contain_text("Select two entries")
        for method in ("RadarScout", "GroundNet++", "VoxTrav"):
            page.get_by_label(f"Compare {method}", exact=True).check()
        expect(page.get_by_label("Compare RadarScout")).not_to_be_checked()
        expect(page.locator("[data-picked]")).to_have_text("GroundNet++ against VoxTrav")
        page.get_by_role("button", name="Compare").click()
        expect(page.get_by_role("heading", level=1)).to_have_text(
            "No significant difference between GroundNet++ and VoxTrav"
        )
        expect(page.locator(".verdict")).to_contain_text("No statement about new places: at least 5 sequences")
        look(page, "compare")
        page.locator("select[name=b]").select_option(board.entries["RadarScout"])
        page.get_by_role("button", name="Compare").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("GroundNet++ is better than RadarScout")
        page.get_by_role("link", name="Swap").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("GroundNet++ is better than RadarScout")


def test_a_board_without_entries_says_what_to_do(site: Site) -> None:
    at = scene(site.platform)
    name = publish(at)
    with site.visit() as page:
        page.goto(f"/benchmarks/{name}/val")
        expect(page.locator(".empty").get_by_role("link", name="Submit")).to_be_visible()
        look(page, "board-empty")
        page.goto(f"/benchmarks/{name}/val/compare")
        expect(page.get_by_role("heading", name="Fewer than two entries")).to_be_visible()
