"""The page that says the one line which installs the client, and the file behind it."""

from collections.abc import Iterator
from hashlib import sha256

import httpx
import pytest
from playwright.sync_api import Browser, expect

from api.client_wheel import FILENAME, ClientWheel
from services.runtime.platform import Platform
from testing.api.serving import serving
from testing.web.browsing import Site
from tests.web.looking import look
from web.main import make_site

WHEEL = ClientWheel(FILENAME, bytes(range(256)) * 400)


@pytest.fixture
def offering(platform: Platform, browser: Browser, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    """A site that has a wheel to offer."""
    monkeypatch.setattr("api.main.client_wheel", lambda: WHEEL)
    with serving(platform, make_site(platform)) as url:
        yield Site(url, platform, browser)


def test_a_visitor_comes_from_the_benchmarks_to_the_one_line(offering: Site) -> None:
    with offering.visit() as page:
        page.goto("/benchmarks")
        page.get_by_role("main").get_by_role("link", name="the client").click()
        line = page.get_by_role("region", name="Install command")
        expect(line).to_have_text(f"pip install {offering.platform.settings.api.url}/downloads/{FILENAME}")
        expect(page.get_by_role("main")).to_contain_text(WHEEL.sha256)
        look(page, "downloads")


def test_where_no_wheel_was_built_the_page_says_who_builds_it(
    platform: Platform, browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.main.client_wheel", lambda: None)
    with serving(platform, make_site(platform)) as url, Site(url, platform, browser).visit() as page:
        page.goto("/downloads/")
        expect(page.get_by_role("main")).to_contain_text("make wheels")
        look(page, "downloads-none")
        assert httpx.get(f"{url}/downloads/{FILENAME}").status_code == 404


def test_the_file_is_served_to_everybody_whole_and_in_parts(offering: Site) -> None:
    answer = httpx.get(f"{offering.url}/downloads/{FILENAME}")
    assert answer.status_code == 200
    assert sha256(answer.content).hexdigest() == WHEEL.sha256
    part = httpx.get(f"{offering.url}/downloads/{FILENAME}", headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, WHEEL.content[100:200])


@pytest.mark.parametrize("name", ["stone_client-0.0.1-py3-none-any.whl", "..%2Fclient_wheel.py", "client_wheel.py"])
def test_no_other_file_is_served(offering: Site, name: str) -> None:
    assert httpx.get(f"{offering.url}/downloads/{name}").status_code == 404
