"""Make the manual's pictures from the folders that `make demo` left: `make pictures`.

`bev.png` is a copy of the demo's map. `demo.webp` shows the 3D view along the demo's run. The other pictures are pages
of a platform on the demo's data, in Chromium, as its administrator sees them. Look at all of them before you commit
them.
"""

import io
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from services.runtime.embedded.first_start import ADMINISTRATOR, first_password_file
from services.runtime.embedded.supervisor import running_platform
from stone_local.embedded_platform import Address, settings_for
from testing.web.chromium import ARGUMENTS

IMAGES = Path(__file__).parents[1] / "docs" / "images"
PATIENCE_MS = 120_000
WORKERS_MS = 30_000
PICTURE_BYTES, FILM_BYTES = 150_000, 1_000_000
EVERY_FRAME, FILM_WIDTH_PX, FRAME_MS = 8, 640, 220
VIEWER = "[data-viewer][data-state=ready]"
CLIP = """viewer => {
    const at = (selector) => viewer.querySelector(selector).getBoundingClientRect();
    const [canvas, bar] = [at(".viewer-canvas"), at(".viewer-timeline")];
    return {x: canvas.x, y: canvas.y, width: canvas.width, height: bar.y - canvas.y};
}"""
SHOW_FRAME = "(viewer, index) => viewer.dispatchEvent(new CustomEvent('show-frame', {detail: {index}}))"


@dataclass(frozen=True)
class TourPicture:
    """A page of the platform as `docs/images/<name>.webp`; `{sequence}` and `{entry}` are the demo's."""

    name: str
    path: str
    ready: str = "h1"
    """A selector of an element that the page shows once it is complete."""
    height_px: int = 800


TOUR = (
    TourPicture("tour-sequence", "/sequences/{sequence}", VIEWER),
    TourPicture("tour-view", "/sequences/{sequence}/view?frame={frame}", VIEWER, 760),
    TourPicture("tour-recordings", "/sequences/{sequence}/recordings"),
    TourPicture("tour-dataset", "/dataset", height_px=760),
    TourPicture("tour-board", "/benchmarks/demo/val", height_px=760),
    TourPicture("tour-method", "/entries/{entry}", height_px=1200),
    TourPicture("tour-submit", "/benchmarks/demo/val/submit", height_px=760),
    TourPicture("tour-jobs", "/admin/jobs"),
)


def make_pictures(demo: Path, data: Path) -> None:
    """Write all pictures; `demo` and `data` are the folders of `stone demo`. Nothing in `demo` is changed."""
    shutil.copyfile(demo / "labels" / "bev.png", IMAGES / "bev.png")
    settings = settings_for(data, Address(port=0), 1)
    password = first_password_file(settings)
    if password is None:
        sys.exit(f"no password of {ADMINISTRATOR} in {data}: run `make demo` with a new data folder")
    with running_platform(settings) as running, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page = _signed_in(browser, running.url, password.read_text("utf-8").strip())
        page.wait_for_timeout(WORKERS_MS)  # until the workers have reported to the page of jobs
        names = _names(page)
        for picture in TOUR:
            _take(page, picture, names)
        _film(page, names["sequence"])
        browser.close()


def _signed_in(browser: Browser, url: str, password: str) -> Page:
    context = browser.new_context(base_url=url, reduced_motion="reduce")
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    page.goto("/sign-in")
    page.get_by_label("Name").fill(ADMINISTRATOR)
    page.get_by_label("Password").fill(password)
    page.get_by_role("button", name="Sign in").click()
    page.wait_for_url(f"{url}/")
    return page


def _names(page: Page) -> dict[str, str]:
    """Return the id of the demo's sequence, the token of its middle frame and the id of the board's first entry."""
    sequences = page.request.get("/api/v1/sequences").json()["items"]
    rows = page.request.get("/api/v1/benchmarks/demo/phases/val/leaderboard").json()["rows"]
    sequence = next(row["id"] for row in sequences if row["name"] == "demo")
    tokens = page.request.get(f"/api/v1/sequences/{sequence}/scene").json()["frames"]["tokens"]
    return {"sequence": sequence, "frame": tokens[len(tokens) // 2], "entry": rows[0]["submission_id"]}


def _take(page: Page, picture: TourPicture, names: dict[str, str]) -> None:
    page.set_viewport_size({"width": 1200, "height": picture.height_px})
    page.goto(picture.path.format(**names))
    page.locator(picture.ready).first.wait_for()
    page.wait_for_load_state("networkidle")
    _save([_shot(page)], f"{picture.name}.webp", PICTURE_BYTES)


def _film(page: Page, sequence: str) -> None:
    """Write the 3D view with its cameras, without its panels, along the sequence."""
    page.set_viewport_size({"width": 1200, "height": 800})
    page.goto(f"/sequences/{sequence}/view")
    viewer = page.locator(VIEWER).first
    viewer.wait_for()
    clip = viewer.evaluate(CLIP)
    frames = int(page.request.get(f"/api/v1/sequences/{sequence}").json()["labels"]["frames"])
    pictures = []
    for index in range(0, frames, EVERY_FRAME):
        viewer.evaluate(SHOW_FRAME, index)
        page.locator(f"[data-viewer][data-frame='{index}']:not([aria-busy])").wait_for()
        page.wait_for_load_state("networkidle")
        shot = _shot(page, clip)
        pictures.append(shot.resize((FILM_WIDTH_PX, round(shot.height * FILM_WIDTH_PX / shot.width))))
    _save(pictures, "demo.webp", FILM_BYTES)


def _shot(page: Page, clip: dict[str, float] | None = None) -> Image.Image:
    return Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB")  # type: ignore[arg-type]


def _save(pictures: list[Image.Image], name: str, most_bytes: int) -> None:
    """Write a WebP, or an animated WebP of several pictures, in the best quality within `most_bytes`."""
    first, others = pictures[0], pictures[1:]
    for quality in (90, 80, 70, 60, 50, 40):
        if others:
            first.save(IMAGES / name, quality=quality, save_all=True, append_images=others, duration=FRAME_MS, loop=0)
        else:
            first.save(IMAGES / name, quality=quality, method=6)
        if (IMAGES / name).stat().st_size <= most_bytes:
            return
    sys.exit(f"{name} has more than {most_bytes} bytes in the lowest quality")


if __name__ == "__main__":
    make_pictures(Path(sys.argv[1]), Path(sys.argv[2]))
