"""The first page: what is newest, for whoever looks."""

import httpx
import numpy as np
from playwright.sync_api import expect
from sqlalchemy import select

from services.runtime.orm import Benchmark, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.benchmark_world import SHAPE, labelled
from tests.api.boarding import boarding
from tests.web.looking import look


def make_public(platform: Platform) -> None:
    with platform.database.transaction() as session:
        for kind in (SequenceRow, Benchmark):
            for row in session.scalars(select(kind)):
                row.is_public = True


def test_an_empty_platform_says_what_to_do_next(site: Site) -> None:
    with site.visit() as page:
        page.goto("/")
        expect(page.get_by_role("heading", name="No labels yet")).to_be_visible()
        look(page, "home-empty")


def test_a_visitor_is_shown_what_is_public_in_3d_and_the_board(site: Site, curator: Person) -> None:
    grid = np.zeros(SHAPE, np.uint8)
    grid[118:138, 118:138, 10] = np.repeat([1, 2, 3, 2], 5)  # few voxels: the tests' browser draws in software
    labelled(site.platform, curator, "forest", [grid, grid])
    with httpx.Client(base_url=site.url) as client:
        board = boarding(client, site.platform)
    with site.visit() as page:
        page.goto("/")
        expect(page.get_by_role("heading", name="No labels yet")).to_be_visible()
        make_public(site.platform)
        page.reload()
        expect(page.get_by_role("link", name="forest")).to_be_visible()
        expect(page.locator("[data-viewer][data-state=ready] canvas")).to_be_visible()
        expect(page.locator("table")).to_contain_text(board.team)
        look(page, "home")
