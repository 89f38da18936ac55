"""The site: `site` on the embedded platform in Debian's Chromium; `reading`, its pages as bytes."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from services.runtime.platform import Platform
from testing.api.serving import serving
from testing.web.browsing import Site
from testing.web.reading import Reading, reading_of
from tests.api.conftest import administrator, curator, participant
from web.main import make_site

__all__ = ["administrator", "curator", "participant", "reading", "site"]


@pytest.fixture
def site(platform: Platform, browser: Browser) -> Iterator[Site]:
    with serving(platform, make_site(platform)) as url:
        yield Site(url, platform, browser)


@pytest.fixture
def reading(platform: Platform) -> Iterator[Reading]:
    with reading_of(platform) as made:
        yield made
