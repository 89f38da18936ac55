"""How fast the 3D viewer is: `python -m benchmarks.viewer [--voxels 60000] [--pictures 40] [--size 1280x720]`.

A run by formula on an embedded platform, its site on a socket of this machine, Debian's Chromium drawing in software
(SwiftShader), so that the figures need no graphics card and are a floor. *First voxel* is from the navigation to the
first picture with labels, with an empty browser and with a full one. *Pictures a second* is the whole view turning
around once, each picture waited for by reading a pixel; beside it the obvious way, one instanced box per voxel.
"""

import argparse
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright
from rich.console import Console
from rich.table import Table

from services.runtime.database.migrate import upgrade
from services.runtime.orm import SequenceRow
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import Settings
from testing.api.serving import person, serving
from testing.web.chromium import ARGUMENTS
from testing.worlds.viewer_world import Run, viewed
from web.main import make_site

WHOLE = Path(__file__).resolve().parents[1] / "web" / "node_modules" / "three" / "build"  # ours leaves boxes out
READY = "[data-viewer][data-state=ready]"
FIRST_VOXEL = "performance.getEntriesByName('first-voxel')[0].startTime"
SCRIPTS = """() => performance.getEntriesByType("resource")
  .filter(one => new URL(one.name).pathname.endsWith("js")).map(one => [one.name, one.encodedBodySize])"""
IMPORTS = """
const { viewerOf } = await import(document.querySelector('script[src*="modules/viewer/mount.js"]').src);
const { stage } = viewerOf(document.querySelector("[data-viewer]"));
"""
BOXES = """
const three = await import("/whole/three.module.js");
const mount = document.querySelector('script[src*="modules/viewer/mount.js"]').src;
const { planesOf, labelled, classAt } = await import(mount.replace("mount.js", "formats.js"));
const { decompress } = await import("fzstd");
const answer = await fetch(`/api/v1/frames/${given.token}/voxels`);
const planes = planesOf(decompress(new Uint8Array(await answer.arrayBuffer())));
const indices = labelled(planes), place = new three.Matrix4(), colours = [0x26a65b, 0xfacd50, 0xb02a37];
const box = new three.BoxGeometry(.2, .2, .2);
const boxes = new three.InstancedMesh(box, new three.MeshBasicMaterial(), indices.length);
indices.forEach((index, row) => {
  const [i, j, k] = [Math.floor(index / 8192), Math.floor(index / 32) % 256, index % 32];
  boxes.setMatrixAt(row, place.setPosition(i * .2 - 25.5, j * .2 - 25.5, k * .2 - 1.9));
  boxes.setColorAt(row, new three.Color(colours[classAt(planes, index) - 1]));
});
stage.scene.children[0].visible = false;
stage.scene.add(boxes);
"""
MEASURE = "stage.measure(2); return [stage.measure(given.pictures), stage.renderer.info.render.triangles];"
CANVAS = "return `${stage.canvas.width} x ${stage.canvas.height} px`;"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voxels", type=int, default=60_000)
    parser.add_argument("--pictures", type=int, default=40)
    parser.add_argument("--size", default="1280x720")
    options = parser.parse_args()
    run = run_of(options.voxels)
    table = Table("figure", "value", title=f"{int((run.grids[0] > 0).sum()):,} voxels in the first frame")
    with site(run) as (url, made), chromium() as browser:
        for row in measured(browser.new_context(base_url=url, viewport=window(options.size)), made, options.pictures):
            table.add_row(*row)
    Console(width=120).print(table)


def run_of(voxels: int) -> Run:
    """The run whose first frame has about so many voxels."""
    return min((Run(2, reach) for reach in np.arange(4.0, 30.0, 2.0)), key=lambda one: abs(_count(one) - voxels))


def _count(run: Run) -> int:
    return int((run.grids[0] > 0).sum())


@contextmanager
def site(run: Run) -> Iterator[tuple[str, dict[str, Any]]]:
    """The site's address and the sequence, which everybody may look at."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_folder=Path(folder))
        settings.root.mkdir(parents=True, exist_ok=True)
        upgrade(settings)
        platform: Platform = open_platform(settings)
        made = viewed(platform, person(platform, "curator"), run)
        with platform.database.transaction() as session:
            session.get_one(SequenceRow, made["id"]).is_public = True
        with serving(platform, make_site(platform)) as url:
            yield url, made
        platform.database.close()


@contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        yield browser
        browser.close()


def window(size: str) -> Any:
    width, height = map(int, size.split("x"))
    return {"width": width, "height": height}


def measured(context: BrowserContext, made: dict[str, Any], pictures: int) -> Iterator[tuple[str, str]]:
    page = context.new_page()
    page.route("**/whole/*", lambda route: route.fulfill(path=WHOLE / route.request.url.rpartition("/")[2]))
    for browser in ("empty", "full"):
        yield f"first voxel, {browser} browser", f"{opened(page, made['id']):.0f} ms"
    sizes = dict(page.evaluate(SCRIPTS))
    yield "scripts on the wire", f"{sum(sizes.values()) / 1e3:.0f} kB in {len(sizes)} files"
    three = sum(size for name, size in sizes.items() if "three" in name)
    yield "of it three.js", f"{three / 1e3:.0f} kB"
    yield "canvas", asked(page, CANVAS)
    given = {"pictures": pictures, "token": made["tokens"][0]}
    for name, more in (("merged faces", ""), ("instanced boxes", BOXES)):
        seconds, triangles = asked(page, more + MEASURE, given)
        rates = f"{1 / np.median(seconds):.1f} (fastest {1 / min(seconds):.1f}, {triangles:,} triangles)"
        yield f"pictures a second, {name}", rates


def asked(page: Page, script: str, given: object = None) -> Any:
    """What the script says of the page's viewer, its `stage`."""
    return page.evaluate(f"async given => {{ {IMPORTS} {script} }}", given)


def opened(page: Page, sequence_id: str) -> float:
    """Milliseconds until the first picture with voxels."""
    page.goto(f"/sequences/{sequence_id}/view")
    page.wait_for_selector(READY, timeout=120_000)
    return float(page.evaluate(FIRST_VOXEL))


if __name__ == "__main__":
    main()
