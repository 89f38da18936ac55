"""Benchmarks, methods and definitions at a browser."""

import pytest
from playwright.sync_api import expect

from services.runtime.orm import Activation
from services.runtime.orm.base import now_ns
from testing.web.browsing import Site
from tests.services.domain.benchmarks.boards import Made
from tests.web.boards_world import DESCRIPTION, Season, season
from tests.web.looking import look


@pytest.fixture
def board(site: Site) -> Season:
    return season(site.platform)


def test_a_method_is_shown_with_its_parts_its_confusion_and_where_it_comes_from(site: Site, board: Season) -> None:
    with site.visit(board.member) as page:
        page.goto(board.path)
        page.get_by_role("link", name="GroundNet++").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("GroundNet++")
        expect(page.locator(".plain-text")).to_have_text(DESCRIPTION)
        for part in ("By environment", "By illumination", "By distance from the robot", "By sequence"):
            expect(page.get_by_role("heading", name=part)).to_be_visible()
        assert page.locator(".matrix .heat").count() == 16
        expect(page.get_by_role("link", name="Your submission")).to_have_attribute("href", f"/submissions/{board.mine}")
        expect(page.get_by_role("link", name="Confusion counts per frame (npz)")).to_be_visible()
        look(page, "entry")
        page.locator("select[name=b]").select_option(label="1. TerrainFormer-L · Hanyang Robotics")
        page.get_by_role("button", name="Compare").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("TerrainFormer-L is better than GroundNet++")


def test_an_older_score_stays_readable_beside_the_one_in_force(site: Site, board: Season) -> None:
    pair = board.at.another_pair(now_ns())
    board.at.score(board.mine, Made(0.1, 2), pair)
    with site.platform.database.reading() as session:
        assert session.query(Activation).filter_by(phase_id=board.at.phase_id).count() == 2
    with site.visit() as page:
        page.goto(f"/entries/{board.mine}")
        page.get_by_text("2 scores of this entry").click()
        page.get_by_role("link", name="Ground truth 1, stone-iou-2").click()
        expect(page.get_by_text("Older score, with ground truth 1")).to_be_visible()
        page.get_by_role("link", name="Show the active score").click()
        expect(page.get_by_text("Older score")).to_have_count(0)


def test_from_the_list_of_benchmarks_one_comes_to_rules_leaders_and_the_definition(site: Site, board: Season) -> None:
    with site.visit() as page:
        page.goto("/benchmarks")
        look(page, "benchmarks")
        page.get_by_role("link", name="STONE", exact=True).last.click()
        expect(page.get_by_role("region", name="Leaders of")).to_be_visible()
        look(page, "benchmark")
        page.get_by_role("link", name="Rules", exact=True).click()
        expect(page.get_by_text("20 per day, not counted as submissions")).to_be_visible()
        page.get_by_role("link", name="stone-iou-2").first.click()
        expect(page.get_by_role("heading", name="What is undefined")).to_be_visible()
        assert page.locator("article em").first.inner_text() == "Occupied"
        look(page, "metric")


def test_without_a_public_benchmark_a_visitor_is_told_to_sign_in(site: Site) -> None:
    with site.visit() as page:
        page.goto("/benchmarks")
        expect(page.get_by_role("heading", name="No benchmark yet")).to_be_visible()
        expect(page.locator("main").get_by_role("link", name="Sign in")).to_be_visible()
