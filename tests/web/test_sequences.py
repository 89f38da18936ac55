"""The list of sequences at a browser."""

import re

import httpx
from playwright.sync_api import expect

from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from tests.web.listed_world import listed_world
from tests.web.looking import look, pictures_load


def test_an_owner_finds_a_sequence_by_what_is_said_of_it(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        listed_world(site.platform, api, curator)
    with site.visit(curator) as page:
        page.goto("/sequences")
        cards = page.locator(".sequence-card")
        expect(cards).to_have_count(6)
        expect(cards.first).to_contain_text("no recording")
        expect(cards.nth(1)).to_contain_text("queued")
        expect(cards.nth(2).get_by_role("img")).to_have_attribute("aria-label", re.compile("traversable 10.0 %"))
        expect(cards.nth(3)).to_contain_text("test")
        pictures_load(page)
        look(page, "sequences")
        page.get_by_label("Environment").select_option("lake")
        page.keyboard.press("Tab")
        page.get_by_role("button", name="Filter").click()
        expect(cards).to_have_count(1)
        page.get_by_label("Name contains").fill("forest")
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="No matching sequences")).to_be_visible()
        page.get_by_role("link", name="Clear").click()
        expect(cards).to_have_count(6)
        link = cards.last.get_by_role("heading").get_by_role("link")
        expect(link).to_have_attribute("href", re.compile("^/sequences/[0-9a-f]{32}$"))


def test_a_visitor_is_shown_what_is_public_and_nothing_of_its_split(site: Site, curator: Person) -> None:
    with site.visit() as page:
        page.goto("/sequences")
        expect(page.get_by_role("heading", name="Nothing is public yet")).to_be_visible()
        look(page, "sequences-none")
        with httpx.Client(base_url=site.url) as api:
            listed_world(site.platform, api, curator)
        page.reload()
        expect(page.locator(".sequence-card")).to_have_count(1)
        expect(page.locator(".sequence-split")).to_have_count(0)
        expect(page.get_by_role("link", name="Upload recordings")).to_have_count(0)


def test_a_name_is_found_by_any_part_of_it(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        for name in ("2026-05-Hill_north", "2026-05-hillXnorth", "lake"):
            sequence(api, curator, name)
    with site.visit(curator) as page:
        page.goto("/sequences")
        page.get_by_label("Name contains").fill("hill_N")
        page.keyboard.press("Enter")
        expect(page.locator(".sequence-card")).to_have_count(1)
        expect(page.locator(".sequence-card")).to_contain_text("2026-05-Hill_north")


def test_a_list_that_is_long_goes_on_by_its_cursor(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url, headers=curator.headers) as api:
        for number in range(25):
            assert api.post("/api/v1/sequences", json={"name": f"run-{number:02}"}).status_code == 201
    with site.visit(curator) as page:
        page.goto("/sequences?name=run")
        expect(page.locator(".sequence-card")).to_have_count(24)
        page.get_by_role("link", name="Older").click()
        expect(page.locator(".sequence-card")).to_have_count(1)
        expect(page.get_by_role("heading", name="run-00")).to_be_visible()
