"""The cost of the web pages for a reader: `python -m benchmarks.pages [--data DIR --url URL] [--turns 3]`.

Without a URL the program first makes a demo of its own (simulated, labelled, submitted: half a minute); otherwise it
uses the running platform with the data in DIR. Every linked page is loaded in Chromium as the administrator, each in a
fresh browser with an empty cache. The table shows the transferred bytes, the server's time (`responseStart −
requestStart`), the largest contentful paint with the first paint, and the cumulative layout shift. Figures are medians
of the turns.
"""

import argparse
import shutil
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
from playwright.sync_api import Browser, sync_playwright
from rich.console import Console
from rich.table import Table

from services.runtime.embedded.first_start import PASSWORD_FILE
from services.runtime.embedded.supervisor import running_platform
from services.runtime.settings import ApiSettings, Settings
from simulator.options import SimulateOptions
from stone_local.demo.pipeline import DemoPlan, run_demo
from testing.web.browsing import DESKTOP
from testing.web.crawling import crawled

SMALL = SimulateOptions(seconds=20.0, seed=3, channels=64, columns=900, cameras=True)
SETTLES_MS = 1500
COLUMNS = (
    "page",
    "requests",
    "kB on the wire",
    "of it scripts",
    "server ms",
    "first paint ms",
    "meaningful ms",
    "shift",
)
WATCH = """
window.shifted = 0; window.largest = 0;
const watch = (type, note) =>
  new PerformanceObserver(list => list.getEntries().forEach(note)).observe({ type, buffered: true });
watch('layout-shift', one => { if (!one.hadRecentInput) window.shifted += one.value; });
watch('largest-contentful-paint', one => { window.largest = one.startTime; });
"""
READ = """() => {
  const page = performance.getEntriesByType('navigation')[0];
  const loaded = [page, ...performance.getEntriesByType('resource')];
  const sum = entries => entries.reduce((total, one) => total + one.transferSize, 0);
  return {
    requests: loaded.length,
    wire_bytes: sum(loaded),
    script_bytes: sum(loaded.filter(one => one.name.includes('/modules/') || one.name.includes('/libraries/'))),
    server_ms: page.responseStart - page.requestStart,
    first_ms: performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN,
    largest_ms: window.largest,
    shift: window.shifted,
  };
}"""


@dataclass(frozen=True)
class PageServer:
    """A platform to measure, and its sign-in."""

    url: str
    name: str
    password: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--url")
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    table = Table(*COLUMNS, title=f"each page in a fresh browser, median of {options.turns}")
    with page_server(options.url, options.data) as demo_server, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--use-angle=swiftshader"]
        )
        cookie = signed_in(demo_server)
        for shape, path in pages_of(demo_server, cookie):
            table.add_row(shape, *page_figures(chromium, demo_server.url + path, cookie, options.turns))
        chromium.close()
    Console(width=150).print(table)


@contextmanager
def page_server(url: str | None, data: Path | None) -> Iterator[PageServer]:
    """Yield the given platform, or a demo's own."""
    if url is not None and data is not None:
        yield PageServer(url, "admin", (data / PASSWORD_FILE).read_text().strip())
        return
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        (base / "demo").mkdir()
        settings = Settings(data_folder=base / "data", workers=2, api=ApiSettings(port=0))
        with running_platform(settings, is_awaited=False) as running:
            run_demo(base / "demo", DemoPlan(SMALL, running), lambda *_: None)
            yield PageServer(running.url, running.keys.name, (base / "data" / PASSWORD_FILE).read_text().strip())


def signed_in(demo_server: PageServer) -> dict[str, str]:
    answer = httpx.post(
        f"{demo_server.url}/api/v1/sessions", json={"name": demo_server.name, "password": demo_server.password}
    )
    answer.raise_for_status()
    return dict(answer.cookies)


def pages_of(demo_server: PageServer, cookie: dict[str, str]) -> list[tuple[str, str]]:
    """Return (shape, path) of one page of each shape, in the order of the shapes."""
    header = {"Cookie": "; ".join(f"{name}={value}" for name, value in cookie.items())}
    with httpx.Client(base_url=demo_server.url, timeout=60.0) as client:
        path_of = {
            page.shape: page.path for page in crawled(client, header) if page.is_page and "/api/" not in page.path
        }
    return sorted(path_of.items())


def page_figures(chromium: Browser, url: str, cookie: dict[str, str], turns: int) -> list[str]:
    """Return the row of a page."""
    loads = [loaded(chromium, url, cookie) for _ in range(turns)]
    median = {key: statistics.median(load[key] for load in loads) for key in loads[0]}
    whole = (median["requests"], median["wire_bytes"] / 1e3, median["script_bytes"] / 1e3, median["server_ms"])
    return [f"{value:.0f}" for value in (*whole, median["first_ms"], median["largest_ms"])] + [f"{median['shift']:.3f}"]


def loaded(chromium: Browser, url: str, cookie: dict[str, str]) -> dict[str, float]:
    """Return the figures of one load with an empty cache."""
    context = chromium.new_context(viewport=DESKTOP)  # type: ignore[arg-type]
    context.add_cookies([{"name": name, "value": value, "url": url} for name, value in cookie.items()])
    page = context.new_page()
    page.add_init_script(WATCH)
    page.goto(url, wait_until="load")
    page.wait_for_timeout(SETTLES_MS)
    figures: dict[str, float] = page.evaluate(READ)
    context.close()
    return figures


if __name__ == "__main__":
    main()
