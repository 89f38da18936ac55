"""Three people, each the whole way at their pages, on the platform as it runs: its own processes, real workers.

**Conventions.** The platform holds a demo of `stone demo`: they use what the demo made and touch nothing of each
other's. Catches alone what breaks between page, API and worker.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from services.runtime.access import users
from services.runtime.embedded.first_start import PASSWORD_FILE
from services.runtime.embedded.supervisor import running_platform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from testing.stone_serve import until
from testing.web.browsing import Site, decide
from testing.worlds.demo import demo_settings, made_demo

PASSWORD = "correct horse battery staple"
SHORT = SimulateOptions(seconds=1.5, seed=5, channels=16, columns=180, camera_width_px=160, lidar_hz=5)
LABELLING_MS = 600_000
PAINTED = """all => all.map(one =>
  one.getContext("2d").getImageData(0, 0, one.width, one.height).data.some(value => value > 0))"""


@dataclass(frozen=True)
class Stage:
    """A platform that is up and holds a demo; `folder` is what the demo left."""

    site: Site
    folder: Path
    admin_password: str

    def somebody(self, name: str, role: str) -> str:
        with self.site.platform.database.transaction() as session:
            return users.create_user(session, name, role, PASSWORD).name


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory, browser: Browser) -> Iterator[Stage]:
    base = tmp_path_factory.mktemp("journeys")
    made = made_demo(tmp_path_factory)
    shutil.copytree(made / "data", base / "data")
    with running_platform(demo_settings(base), is_awaited=False) as running:
        password = (running.platform.settings.root / PASSWORD_FILE).read_text().strip()
        yield Stage(Site(running.url, running.platform, browser), made / "demo", password)


def sign_in(page: Page, name: str, password: str = PASSWORD) -> None:
    page.goto("/sign-in")
    page.get_by_label("Name").fill(name)
    page.get_by_label("Password").fill(password)
    page.keyboard.press("Enter")
    expect(page.locator(".who")).to_contain_text(name)


def test_an_engineer_brings_a_recording_and_looks_at_its_labels(stage: Stage, tmp_path: Path) -> None:
    bag = tmp_path / "forest.mcap"
    simulate(bag, SHORT)
    with stage.site.visit() as page:
        sign_in(page, stage.somebody("engineer", "curator"))
        page.goto("/sequences/new")
        page.locator("[data-files]").set_input_files(bag)
        page.get_by_label("Sequence", exact=True).fill("forest")
        page.get_by_role("button", name="Upload").click()
        page.get_by_role("link", name="Open the sequence").click()
        page.locator("#calibration [data-files]").set_input_files(calibration_path(bag))
        page.get_by_role("button", name="Start processing").click()
        expect(page.get_by_role("link", name="Open in 3D")).to_be_visible(timeout=LABELLING_MS)
        scene = f"/api/v1/sequences/{page.url.split('/')[4].partition('#')[0]}/scene"
        until(lambda: page.request.get(scene).json()["playback"]["state"] == "ready", LABELLING_MS / 1000)
        page.get_by_role("link", name="Open in 3D").click()
        expect(page.locator("[data-viewer][data-state=ready] .viewer-canvas")).to_be_visible()
        expect(page.locator(".viewer-cameras")).to_have_attribute("data-frame", "0")
        assert page.locator(".viewer-camera-row canvas").evaluate_all(PAINTED) == [True] * 6


def test_an_administrator_stops_a_run_and_has_it_done_again(stage: Stage, tmp_path: Path) -> None:
    with stage.site.visit() as page:
        sign_in(page, "admin", stage.admin_password)
        page.goto("/sequences")
        page.get_by_role("link", name="demo", exact=True).first.click()
        page.get_by_role("link", name="Processing").click()
        page.get_by_role("radio", name="local").check()
        at = page.expect_response(lambda answer: answer.url.endswith("/process"))
        with page.expect_navigation(), at as started:
            page.get_by_role("button", name="Start processing").click()
        page.goto("/admin/jobs")
        run_id = started.value.headers["location"].rpartition("/")[2]
        with page.expect_navigation():
            page.locator(f"a[href='/admin/jobs/{run_id}']").click()
        decide(page, "Cancel", "wrong profile")
        expect(page.locator("#job")).to_have_attribute("data-state", "cancelled", timeout=LABELLING_MS)
        decide(page, "Retry", "it was right after all")
        expect(page.locator("#job")).to_have_attribute("data-state", "succeeded", timeout=LABELLING_MS)
        page.goto("/admin/audit")
        expect(page.locator(".audit-why", has_text="wrong profile")).to_be_visible()


def test_a_participant_submits_and_stands_on_the_board(stage: Stage) -> None:
    with stage.site.visit(expected=["403"]) as page:
        page.goto("/sequences")
        expect(page.get_by_role("link", name="demo", exact=True).first).to_be_visible()  # to anybody
        sign_in(page, stage.somebody("participant", "participant"))
        page.goto("/benchmarks")
        page.get_by_role("link", name="Demo").first.click()
        page.goto("/benchmarks/demo/val/submit")
        page.get_by_label("Team name").fill("Terrain Gang")
        page.get_by_role("button", name="Create team").click()
        page.locator("#file").set_input_files(stage.folder / "baseline.zip")
        page.get_by_label("Method name").fill("GroundNet")
        page.get_by_label("LiDAR").check()
        page.get_by_role("button", name="Submit for scoring").click()
        page.get_by_role("link", name="View results").click(timeout=LABELLING_MS)
        page.goto("/benchmarks/demo/val")
        expect(page.locator("table").get_by_text("Terrain Gang")).to_be_visible()
        answer = page.goto("/admin/jobs")
        assert answer is not None
        assert answer.status == 403
