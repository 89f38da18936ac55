"""The docs site: built strictly, whole by itself, and looked at.

Catches alone a link, an anchor or a picture of the built site that leads nowhere.
"""

import re
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import unquote, urlsplit

import pytest
from playwright.sync_api import Browser, expect

from testing.web.browsing import Watch, context_for
from tests.docsite.conftest import Built
from tests.web.looking import look

pytestmark = pytest.mark.whole

LOOKED_AT = ("index.html", "reference/api/sequences.html")
PLATFORM = "/"  # the first page of the platform that serves the site


class Quiet(SimpleHTTPRequestHandler):
    """Serves files and says nothing."""

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def url(built: Built) -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(built.folder))) as server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_the_build_warns_of_nothing(built: Built) -> None:
    assert not re.search(r"(?m)^(WARNING|ERROR)", built.printed), built.printed
    assert len(built.pages) > 40


def test_every_link_and_picture_leads_to_a_file_and_to_a_place_in_it(built: Built) -> None:
    pages = {page.path: page for page in built.pages}
    broken = []
    for page in pages.values():
        for link in (*page.links, *page.loaded):
            parts = urlsplit(link)
            if (
                link == PLATFORM
                or parts.scheme
                or parts.netloc
                or link.startswith(("#__", "data:"))
                or page.path.name == "404.html"
            ):
                continue
            target = (page.path.parent / unquote(parts.path)).resolve() if parts.path else page.path
            is_there = target.is_file() or (target / "index.html").is_file()
            if target in pages and parts.fragment:
                is_there = unquote(parts.fragment) in pages[target].places
            if not is_there:
                broken.append((page.path.relative_to(built.folder).as_posix(), link))
    assert broken == []


def test_nothing_is_loaded_from_another_host(built: Built) -> None:
    outside = re.compile(r"""(?:url\(|@import)\s*["']?(?:https?:)?//""")
    loaded = {(page.path.name, one) for page in built.pages for one in page.loaded}
    assert {one for one in loaded if urlsplit(one[1]).netloc or urlsplit(one[1]).scheme in ("http", "https")} == set()
    assert [path.name for path in built.folder.rglob("*.css") if outside.search(path.read_text("utf-8"))] == []
    # What the theme would fetch from a CDN for it, were it there.
    assert "mermaid" not in {name for page in built.pages for name in page.classes}


@pytest.mark.parametrize("path", LOOKED_AT)
def test_the_pages_are_looked_at(url: str, browser: Browser, path: str) -> None:
    watch = Watch(url)
    with context_for(browser, url) as context:
        page = context.new_page()
        page.on("console", watch.console)
        page.on("request", watch.request)
        page.goto(f"/{path}")
        expect(page.locator("h1").first).to_be_visible()
        look(page, f"docs-{Path(path).with_suffix('').as_posix().replace('/', '-')}")
    assert watch.unexpected() == []


def test_the_search_finds_a_word_where_the_site_is_opened_from_a_folder(built: Built, browser: Browser) -> None:
    asked: list[str] = []
    with context_for(browser, built.folder.as_uri()) as context:
        page = context.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.goto((built.folder / "index.html").as_uri())
        page.locator("[data-md-component='search-query']").press_sequentially("STONE_JOBS__LEASE_S")
        found = page.locator(".md-search-result__item a[href*='reference/configuration.html']")
        expect(found.first).to_be_attached()
    assert {url.partition(":")[0] for url in asked} <= {"file", "data", "blob"}
