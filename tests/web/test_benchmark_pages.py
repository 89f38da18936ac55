"""A benchmark as a visitor and then a participant uses it: its sections, its downloads, the first submission.

**Conventions.** A world with real labels and zips, its benchmark public. Catches alone a download of the pages that is
not what it says, a starter script whose zip is refused, and a picture of a frame that does not load.
"""

import hashlib
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import select

from services.runtime.orm import Benchmark, Dataset, Score
from services.runtime.platform import Platform
from testing.web.browsing import Site
from testing.worlds.benchmark_world import World, benchmark_world, run_eval
from testing.worlds.sending import guess, send, zipped
from tests.api.inputs_made import made_input, made_version_input
from tests.web.looking import look

SENSED = {"v1.0-trainval/sample.json": b"[]\n", "samples/LIDAR_TOP/0.bin": b"\x00" * 3000}
LOADED = "image => image.complete && image.naturalWidth > 0"


@dataclass(frozen=True)
class Opened:
    """The world, its entries by name, and the paths of its pages."""

    world: World
    entry: str
    hidden: str

    @property
    def benchmark(self) -> str:
        return f"/benchmarks/{self.world.benchmark}"


@pytest.fixture
def opened(platform: Platform) -> Opened:
    world = benchmark_world(platform, frames=3)
    entry = send(world, zipped(world, guess(world)))
    send(world, zipped(world, guess(world, turn=2)), kind="baseline", team=1)
    hidden = send(world, zipped(world, guess(world, "test")), "test")
    run_eval(platform)
    made_input(platform, world.val, next(iter(world.grids["val"])), SENSED)
    with platform.database.transaction() as session:
        benchmark = session.scalars(select(Benchmark)).one()
        benchmark.is_public, benchmark.title = True, "STONE"
    return Opened(world, entry, hidden)


def scored(opened: Opened) -> str:
    """The id of the entry's score."""
    with opened.world.platform.database.reading() as session:
        return session.scalars(select(Score.id).where(Score.submission_id == opened.entry)).one()


def tab(page: Page, name: str) -> None:
    page.get_by_role("navigation", name="Benchmark").get_by_role("link", name=name, exact=True).click()
    expect(page.get_by_role("navigation", name="Benchmark").locator("[aria-current=page]")).to_have_text(name)


def expect_pictures(page: Page, count: int) -> None:
    pictures = page.locator("main img.picture")
    expect(pictures).to_have_count(count)
    for picture in pictures.all():
        picture.scroll_into_view_if_needed()
        expect(picture).to_have_js_property("complete", True)
        assert picture.evaluate(LOADED)


def fetched(page: Page, name: str, folder: Path) -> Path:
    """The file that the link of this name downloads."""
    with page.expect_download() as download:
        page.get_by_role("link", name=name, exact=True).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path


def test_a_visitor_sees_all_of_a_public_benchmark(site: Site, opened: Opened) -> None:
    with site.visit() as page:
        page.goto("/benchmarks")
        page.get_by_role("link", name="STONE", exact=True).last.click()
        expect(page.get_by_role("heading", name="Task")).to_be_visible()
        expect(page.get_by_text("N, non-traversable")).to_be_visible()
        expect_pictures(page, 1)
        look(page, "benchmark-overview")
        tab(page, "Data")
        expect(page.get_by_role("link", name="Sign in to download").first).to_be_visible()
        assert page.locator("main a[href^='/api/v1'][download]").count() == 2  # manifest, test vectors
        look(page, "benchmark-data-visitor")
        tab(page, "Rules")
        expect(page.get_by_text("20 per day, not counted as submissions")).to_be_visible()
        expect(page.get_by_text("pictures of frames beside the ground truth").first).to_be_visible()
        look(page, "benchmark-rules")
        tab(page, "Leaderboard")
        expect(page.locator("details.board-history")).not_to_have_attribute("open", "")
        order = "() => document.querySelector('#board table').compareDocumentPosition(document.querySelector('#when'))"
        assert page.evaluate(order) & 4  # the table comes first
        look(page, "benchmark-board")
        tab(page, "Submit")
        expect(page.get_by_role("heading", name="Sign in to submit")).to_be_visible()
        expect(page.locator("form#submit")).to_have_count(0)
        look(page, "benchmark-submit-visitor")
        page.goto(f"/entries/{opened.entry}")
        expect_pictures(page, 3)
        page.get_by_role("link", name="Next").click()
        expect(page.get_by_text("frame 5 of 6")).to_be_visible()
        expect_pictures(page, 3)
        look(page, "entry-frames")
        score = scored(opened)
        page.goto(f"/entries/{opened.entry}?score={score}")
        expect_pictures(page, 3)
        sources = page.locator("main img.picture").evaluate_all("all => all.map(one => one.src)")
        assert all(f"score={score}" in source for source in sources), "a picture of another score's ground truth"
        page.goto(f"/entries/{opened.hidden}")
        expect(page.get_by_text("No frames are shown")).to_be_visible()
        expect_pictures(page, 0)


def test_a_participant_downloads_predicts_and_submits(site: Site, opened: Opened, tmp_path: Path) -> None:
    with site.visit(opened.world.captains[1], permissions=["clipboard-read", "clipboard-write"]) as page:
        page.goto(f"{opened.benchmark}/val/data")
        look(page, "benchmark-data")
        manifest = fetched(page, "Manifest", tmp_path)
        starter = fetched(page, "predict.py", tmp_path)
        name = next(iter(opened.world.grids["val"]))
        tar = fetched(page, f"{name}.tar", tmp_path)
        page.get_by_role("button", name=f"Copy the sha256 of {name}.tar").click()
        expect(page.locator("#toasts")).to_contain_text("Copied.")
        copied = page.evaluate("navigator.clipboard.readText()")
        assert copied == hashlib.sha256(tar.read_bytes()).hexdigest()
        assert set(json.loads(manifest.read_text())["sequences"]) == set(opened.world.grids["val"])
        baseline = page.locator("a[href$='predictions.zip']").get_attribute("href") or ""
        assert page.request.get(baseline).body() == zipped(opened.world, guess(opened.world, turn=2))
        archive = tmp_path / "run.zip"
        subprocess.run([sys.executable, starter, manifest, archive], check=True, timeout=120)
        tab(page, "Submit")
        page.get_by_role("button", name="Copy: Submit").click()
        expect(page.locator("#toasts")).to_contain_text("Copied.")
        line = page.evaluate("navigator.clipboard.readText()")
        assert line.startswith(f"stone submit run.zip --benchmark {opened.world.benchmark} --phase val --team ")
        look(page, "benchmark-submit")
        page.locator("#file").set_input_files(archive)
        expect(page.get_by_text("All 6 frames are present.")).to_be_visible()


def test_inputs_of_train_are_on_the_page_too(site: Site, opened: Opened, tmp_path: Path) -> None:
    name = next(iter(opened.world.grids["train"]))
    with site.platform.database.reading() as session:
        dataset = session.scalars(select(Dataset)).one()
    made = made_version_input(site.platform, dataset.id, name, SENSED)
    with site.visit(opened.world.captains[0]) as page:
        page.goto(f"{opened.benchmark}/test/data")
        expect(page.get_by_text("Zips of a phase with hidden ground truth are not given out")).to_be_visible()
        tar = fetched(page, f"{name}.tar", tmp_path)
        assert hashlib.sha256(tar.read_bytes()).hexdigest() == made.tar[1]
