"""The site: `site` on the embedded platform in Debian's Chromium; `reading`, its pages as bytes."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, BrowserContext

from services.runtime.platform import Platform
from testing.api.serving import serving
from testing.servers.process import free_port
from testing.web.browsing import Site, context_for
from testing.web.reading import Reading, reading_of
from tests.api.conftest import administrator, curator, participant
from web.main import make_site

__all__ = ["administrator", "curator", "participant", "reading", "site"]


@pytest.fixture(scope="session")
def kept(browser: Browser) -> Iterator[tuple[int, BrowserContext]]:
    """A port that every test serves its site on, and a browser that has loaded what the pages of all of them share."""
    port = free_port()
    context = context_for(browser, f"http://127.0.0.1:{port}")
    yield port, context
    context.close()


@pytest.fixture
def site(platform: Platform, browser: Browser, kept: tuple[int, BrowserContext]) -> Iterator[Site]:
    port, context = kept
    with serving(platform, make_site(platform), port) as url:
        yield Site(url, platform, browser, context)


@pytest.fixture
def reading(platform: Platform) -> Iterator[Reading]:
    with reading_of(platform) as made:
        yield made
