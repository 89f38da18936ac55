"""Users with a browser: the site on a real socket, Debian's Chromium, and signed-in users.

**Conventions.** Tests that are not about signing in use a cookie. An error on a page's console, or a request to another
host, fails the test that viewed the page. A shared browser loads scripts and styles once for all tests of a process;
between visits its cookies and stored data are deleted. One page without scripts stays open in it: otherwise Chromium
ends the site's renderer, and restarting it costs each visit 0.7 CPU seconds.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Request

from api.middleware.context import COOKIE
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.signed_in import secret_of

PATIENCE_MS = 300_000
DESKTOP = {"width": 1280, "height": 860}
PHONE = {"width": 390, "height": 844}
PLAIN_PAGE = "/healthz"


@dataclass
class Watch:
    """Faults of a page: `faults` are sentences. `expected` are words of errors that a test provokes."""

    origin: str
    faults: list[str] = field(default_factory=list)
    expected: list[str] = field(default_factory=list)

    def console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.faults.append(f"console: {message.text} ({message.location.get('url')})")

    def request(self, request: Request) -> None:
        parts = urlsplit(request.url)
        if parts.scheme in ("http", "https") and f"{parts.scheme}://{parts.netloc}" != self.origin:
            self.faults.append(f"asked another host: {request.url}")

    def unexpected(self) -> list[str]:
        return [fault for fault in self.faults if not any(words in fault for words in self.expected)]


@dataclass(frozen=True)
class Site:
    """The site of a platform, and a browser to view it."""

    url: str
    platform: Platform
    browser: Browser
    kept: BrowserContext | None = None
    """The context of this address; the first concurrent visit without options uses it."""

    @contextmanager
    def visit(self, who: Person | None = None, **options: Any) -> Iterator[Page]:
        """Yield a page in a fresh browser of `who` (None: a visitor); check its faults at the end.

        `expected=["401"]` names errors of the console that the test provokes; the rest are options of the context.
        """
        watch = Watch(self.url, expected=list(options.pop("expected", [])))
        is_kept = self.kept is not None and not options and len(self.kept.pages) <= 1
        context = self.kept if self.kept is not None and is_kept else context_for(self.browser, self.url, **options)
        if is_kept and not context.pages:
            context.new_page().goto(PLAIN_PAGE)
        if who is not None:
            context.add_cookies([{"name": COOKIE, "value": secret_of(self.platform, who), "url": self.url}])
        page = context.new_page()
        page.on("console", watch.console)
        page.on("pageerror", lambda error: watch.faults.append(f"thrown: {error}"))
        page.on("request", watch.request)
        try:
            yield page
            assert watch.unexpected() == [], watch.unexpected()
        finally:
            if is_kept:
                forget(context, self.url)
            else:
                context.close()


def context_for(browser: Browser, url: str, **options: Any) -> BrowserContext:
    """Return a new browser context for the site at `url`."""
    usual: dict[str, Any] = {"viewport": DESKTOP, "reduced_motion": "reduce"}
    context = browser.new_context(base_url=url, **usual | options)
    context.set_default_timeout(PATIENCE_MS)
    return context


def forget(context: BrowserContext, url: str) -> None:
    """Close its pages except the first, and delete all stored data except loaded files."""
    kinds = {"origin": url, "storageTypes": "local_storage,indexeddb,cache_storage,service_workers"}
    for page in context.pages[1:]:
        context.new_cdp_session(page).send("Storage.clearDataForOrigin", kinds)
        page.close()
    context.clear_cookies()


def decide(page: Page, button: str, reason: str, submit: str = "") -> None:
    """Press a button that requires a reason, enter it, and wait until the page has reloaded.

    The part of the page with the new state may appear before the page reloads, and clicks in between are lost with the
    old page.
    """
    page.get_by_role("button", name=button).first.click()
    asking = page.get_by_role("dialog")
    asking.get_by_label("Reason").fill(reason)
    with page.expect_navigation():
        asking.get_by_role("button", name=submit or button).last.click()
