"""The board at a browser."""

import pytest
from playwright.sync_api import expect

from tests.web.boards_world import Season, season
from tests.web.browsing import Site
from tests.web.looking import look


@pytest.fixture
def board(site: Site) -> Season:
    return season(site.platform)


def test_a_visitor_reads_the_board(site: Site, board: Season) -> None:
    with site.visit() as page:
        page.goto(board.path)
        expect(page.get_by_role("heading", name="Validation")).to_be_visible()
        look(page, "board")
