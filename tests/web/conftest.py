"""The site and a browser: `site` on the embedded platform, in Debian's Chromium."""

import os
import shutil
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from services.runtime.platform import Platform
from tests.api.conftest import administrator, curator, participant
from tests.api.serving import serving
from tests.web.browsing import PATIENCE_MS, Site
from web.main import make_site

__all__ = ["administrator", "browser", "curator", "participant", "site"]

ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-gpu-rasterization",
]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium, one for all tests of a process."""
    path = os.environ.get("STONE_CHROMIUM") or shutil.which("chromium")
    if path is None:
        pytest.skip("no chromium on PATH; deploy/install-browser.sh installs it")
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def site(platform: Platform, browser: Browser) -> Iterator[Site]:
    with serving(platform, make_site(platform)) as url:
        yield Site(url, platform, browser)
