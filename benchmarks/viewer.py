"""Speed of the 3D viewer: `python -m benchmarks.viewer [--voxels N] [--pictures N] [--openings N] [--size 1280x720]`.

A generated run on an embedded platform is opened in Debian's Chromium with software rendering (SwiftShader), so that
the figures need no graphics card and are a floor. *First voxel* is from the navigation to the first image with labels.
It is measured once with an empty browser, when the site warms up too, and many times with a warm one, alternating with
and without cameras. Median and quartiles are printed, since one opening may last half as long again as the next.
*Images per second* is the whole view turning around once, each image awaited by reading a pixel; the reference is the
simplest method, one instanced box per voxel. All is measured with the six cameras hidden and shown, and also the
cameras' own costs: the step from frame to frame, and the labels cast into six images. The cameras take some of the 3D
view's height, so read the canvas's size.
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
from stone.labels.class_colours import CLASS_RGB, hex_of
from testing.api.serving import person, serving
from testing.web.chromium import ARGUMENTS
from testing.worlds.viewer_world import Run, viewed
from web.main import make_site

WHOLE = Path(__file__).resolve().parents[1] / "web" / "node_modules" / "three" / "build"  # ours leaves boxes out
READY = "[data-viewer][data-state=ready]"
SAID_OF_CAMERAS = {"off": "cameras hidden", "labels": "cameras on"}
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
const { planesOf, labelled, classAt } = await import(mount.replace("mount.js", "data/formats.js"));
const { decompress } = await import("fzstd");
const answer = await fetch(`/api/v1/frames/${given.token}/voxels`);
const { grid } = viewerOf(document.querySelector("[data-viewer]")).scene;
const planes = planesOf(decompress(new Uint8Array(await answer.arrayBuffer())), grid);
const indices = labelled(planes), place = new three.Matrix4(), colours = given.colours;
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
STEPS = """
const viewer = viewerOf(document.querySelector("[data-viewer]")), took = [];
for (let n = 0; n < given.pictures; n++) {
  const began = performance.now();
  await viewer.show((n + 1) % 2);
  if (n > 1) took.push((performance.now() - began) / 1000);
}
return took;
"""
CASTS = """
const { world } = viewerOf(document.querySelector("[data-viewer]")), took = [];
const sizes = [0, 1, 2, 3, 4, 5].map(camera => ({ camera, width: given.width, height: given.height }));
const asked = { kind: "camera-views", token: given.token, look: { mode: "class", classes: 14, unseen: "fade" }, sizes };
for (let n = 0; n < 12; n++) {
  const began = performance.now();
  await world.asking.ask(asked);
  if (n > 1) took.push((performance.now() - began) / 1000);
}
return took;
"""
CANVAS = "return `${stage.canvas.width} x ${stage.canvas.height} px`;"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voxels", type=int, default=60_000)
    parser.add_argument("--pictures", type=int, default=40)
    parser.add_argument("--openings", type=int, default=12)
    parser.add_argument("--size", default="1280x720")
    options = parser.parse_args()
    run = run_of(options.voxels)
    table = Table("figure", "value", title=f"{int((run.grids[0] > 0).sum()):,} voxels in the first frame")
    with site(run) as (url, made), chromium() as browser:
        context = browser.new_context(base_url=url, viewport=window(options.size))
        rows = [*first_voxels(context, made["id"], options.openings)]
        for cameras in SAID_OF_CAMERAS:
            rows += measured(context, (made, cameras), options.pictures)
        context.close()
    for row in rows:
        table.add_row(*row)
    Console(width=120).print(table)


def run_of(voxels: int) -> Run:
    """Return the run whose first frame has about `voxels` voxels."""
    return min((Run(2, reach) for reach in np.arange(4.0, 30.0, 2.0)), key=lambda run: abs(_count(run) - voxels))


def _count(run: Run) -> int:
    return int((run.grids[0] > 0).sum())


@contextmanager
def site(run: Run) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the site's address and a public sequence."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_folder=Path(folder))
        settings.root.mkdir(parents=True, exist_ok=True)
        upgrade(settings)
        platform: Platform = open_platform(settings)
        made = viewed(platform, person(platform, "curator"), run, has_cameras=True)
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


def first_voxels(context: BrowserContext, sequence_id: str, openings: int) -> Iterator[tuple[str, str]]:
    """Yield rows of the time to the first image with voxels."""
    page = context.new_page()
    yield "first voxel, empty browser", f"{opened(page, sequence_id, 'off'):.0f} ms"
    took: dict[str, list[float]] = {cameras: [] for cameras in SAID_OF_CAMERAS}
    for _ in range(openings):
        for cameras, lasted in took.items():
            lasted.append(opened(page, sequence_id, cameras))
    for cameras, lasted in took.items():
        low, middle, high = np.percentile(lasted[1:], (25, 50, 75))  # the first one compiles for the others
        yield f"first voxel, full browser, {SAID_OF_CAMERAS[cameras]}", f"{middle:.0f} ms ({low:.0f}-{high:.0f})"
    page.close()


def measured(context: BrowserContext, shown: tuple[dict[str, Any], str], pictures: int) -> Iterator[tuple[str, str]]:
    """Yield rows of the table for this sequence with the cameras "off" or with "labels"."""
    (made, cameras), page = shown, context.new_page()
    cameras_text = SAID_OF_CAMERAS[cameras]
    page.route("**/whole/*", lambda route: route.fulfill(path=WHOLE / route.request.url.rpartition("/")[2]))
    opened(page, made["id"], cameras)
    given = {"pictures": pictures, "token": made["tokens"][0]}
    yield f"canvas, {cameras_text}", evaluate_in_viewer(page, CANVAS)
    yield f"step to the next frame, {cameras_text}", milliseconds(evaluate_in_viewer(page, STEPS, given))
    yield f"pictures a second, {cameras_text}", rates(evaluate_in_viewer(page, MEASURE, given))
    if cameras == "off":
        yield from compared(page, given)
        return
    for width, height in ((320, 200), (160, 100)):
        took = evaluate_in_viewer(page, CASTS, {**given, "width": width, "height": height})
        yield f"six pictures of {width} × {height} labelled", milliseconds(took)


def compared(page: Page, given: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield rows without cameras: the transferred data, and the simplest way of drawing."""
    sizes = dict(page.evaluate(SCRIPTS))
    yield "scripts on the wire", f"{sum(sizes.values()) / 1e3:.0f} kB in {len(sizes)} files"
    three = sum(size for name, size in sizes.items() if "three" in name)
    yield "of it three.js", f"{three / 1e3:.0f} kB"
    given = given | {"colours": [int(hex_of(colour)[1:], 16) for colour in CLASS_RGB.values()]}
    yield "pictures a second, instanced boxes", rates(evaluate_in_viewer(page, BOXES + MEASURE, given))


def rates(measured_s: tuple[list[float], int]) -> str:
    seconds, triangles = measured_s
    return f"{1 / np.median(seconds):.1f} (fastest {1 / min(seconds):.1f}, {triangles:,} triangles)"


def milliseconds(seconds: list[float]) -> str:
    return f"{1000 * np.median(seconds):.0f} ms (fastest {1000 * min(seconds):.0f})"


def evaluate_in_viewer(page: Page, script: str, given: object = None) -> Any:
    """Return the script's result in the page's viewer, its `stage`."""
    return page.evaluate(f"async given => {{ {IMPORTS} {script} }}", given)


def opened(page: Page, sequence_id: str, cameras: str) -> float:
    """Return milliseconds until the first image with voxels; ends after the cameras have loaded too."""
    page.goto(f"/sequences/{sequence_id}/view?cameras={cameras}")
    page.wait_for_selector(READY, timeout=120_000)
    if cameras != "off":
        page.wait_for_selector(".viewer-cameras[data-frame]", timeout=120_000)
    return float(page.evaluate(FIRST_VOXEL))


if __name__ == "__main__":
    main()
