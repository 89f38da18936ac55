"""Generate the manual's images from the output of `make demo`: `make pictures`.

`bev.png` is the demo's map; `first-page.png` is the first page of a platform on the demo's data, in Chromium.
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

from services.runtime.embedded.supervisor import running_platform
from stone_local.embedded_platform import Address, settings_for
from testing.web.chromium import ARGUMENTS

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SIZE_PX = {"width": 1000, "height": 1160}
DRAWN_MS = 120_000


def make_pictures(demo: Path, data: Path) -> None:
    """Write both images; `demo` and `data` are the folders of `stone demo`, which are not changed."""
    shutil.copyfile(demo / "labels" / "bev.png", IMAGES / "bev.png")
    with running_platform(settings_for(data, Address(port=0), 1)) as running, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page = browser.new_page(viewport=SIZE_PX)  # type: ignore[arg-type]
        page.goto(running.url)
        page.locator("[data-viewer][data-state=ready]").first.wait_for(timeout=DRAWN_MS)
        page.wait_for_load_state("networkidle")
        page.screenshot(path=IMAGES / "first-page.png")
        browser.close()


if __name__ == "__main__":
    make_pictures(Path(sys.argv[1]), Path(sys.argv[2]))
