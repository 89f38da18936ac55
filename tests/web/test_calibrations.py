"""Calibrations at a browser: dropped, refused with their findings, drawn, compared, pinned."""

from pathlib import Path

import httpx
import yaml  # type: ignore[import-untyped]
from playwright.sync_api import Page, expect

from simulator.pipeline import calibration_path
from testing.api.serving import Person, person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from tests.web.bringing import bag
from tests.web.looking import look


def moved(source: Path, target: Path, by_m: float) -> Path:
    """The calibration with its first sensor that much higher."""
    said = yaml.safe_load(source.read_text())
    first = next(iter(said["sensors"].values()))
    first["lidar_from_sensor"]["translation_m"][2] += by_m
    target.write_text(yaml.safe_dump(said))
    return target


def drop(page: Page, path: Path) -> None:
    page.locator("[data-calibrations] [data-files]").set_input_files(path)


def test_a_calibration_is_brought_corrected_and_pinned(site: Site, curator: Person, tmp_path: Path) -> None:
    good = calibration_path(bag())
    broken = moved(good, tmp_path / "broken.yaml", 500.0)
    second = moved(good, tmp_path / "second.yaml", 0.012)
    with httpx.Client(base_url=site.url) as api:
        sequence(api, curator, "forest")
    with site.visit(curator, expected=["422"]) as page:
        page.goto("/calibrations")
        expect(page.get_by_role("heading", name="No calibration yet")).to_be_visible()
        look(page, "calibrations-empty")
        drop(page, broken)
        result = page.locator(".transfer").filter(has_text="broken.yaml")
        expect(result.locator(".state")).to_have_text("refused")
        expect(result.locator(".finding code")).to_contain_text("CAL-4")
        expect(result.locator(".finding")).to_contain_text("the limit is 100 m")
        look(page, "calibrations-refused")
        for path in (good, second):
            drop(page, path)
            expect(page.locator(".transfer").filter(has_text=path.name).locator(".state")).to_have_text("added")
        expect(page.locator("#calibrations tbody tr")).to_have_count(2)
        look(page, "calibrations")
        page.get_by_label("Name contains").fill("nothing-so-called")
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="No matching calibrations")).to_be_visible()
        page.get_by_label("Name contains").fill("one-SIM")
        page.keyboard.press("Enter")
        expect(page.locator("#calibrations tbody tr")).to_have_count(2)
        page.locator("#calibrations tbody tr").first.get_by_role("link").click()
        expect(page.get_by_role("heading", name="Changes")).to_be_visible()
        expect(page.get_by_role("row").filter(has_text="12.0")).to_have_count(1)
        page.get_by_label("Assign to").select_option(label="forest")
        page.get_by_role("button", name="Assign").click()
        expect(page.get_by_role("link", name="forest")).to_be_visible()
        look(page, "calibration")


def test_a_calibration_of_somebody_else_is_not_there(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        file = {"file": ("rig.yaml", calibration_path(bag()).read_bytes())}
        made = api.post("/api/v1/calibrations", files=file, headers=curator.headers).json()
    other = person(site.platform, "curator")
    for who, status in ((None, 401), (other, 404), (curator, 200)):
        with site.visit(who, expected=["401", "404"]) as page:
            answer = page.goto(f"/calibrations/{made['id']}")
            assert answer is not None
            assert answer.status == status
