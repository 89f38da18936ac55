"""Datasets and calibrations come in at pages: sent and watched, refused with what is wrong, compared, pinned."""

import gzip
import zipfile
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect
from sqlalchemy import select

from services.runtime.orm import DatasetImport, Job
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from testing.api.serving import Person, serving
from testing.servers.fixtures import having
from testing.web.browsing import Site
from testing.worlds.made import sequence
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from tests.web.bringing import bag, moved, uploads
from tests.web.looking import look
from web.main import make_site

GOOD = SyntheticDataset(labels=(made_labels(1),), splits={"train": ["field-0000"], "val": ["field-0001"]})


@pytest.fixture
def tar(tmp_path: Path) -> Path:
    return write_published_tar(tmp_path / "offroad.tar", GOOD)


def imports(platform: Platform) -> list[DatasetImport]:
    with platform.database.reading() as session:
        return list(session.scalars(select(DatasetImport).order_by(DatasetImport.id)))


def test_a_tar_is_sent_once_and_its_import_watched_and_forgotten(
    site: Site, curator: Person, tar: Path, tmp_path: Path
) -> None:
    """What is refused before a byte is sent, what the platform refuses, and what only the import finds out."""
    packed, classes, wrong = tar.with_suffix(".tar.gz"), tmp_path / "classes.yaml", tmp_path / "wrong.yaml"
    packed.write_bytes(gzip.compress(tar.read_bytes()))
    classes.write_text("name: theirs\nclasses: {0: free, 1: T, 2: P, 3: N}\n")
    wrong.write_text("name: theirs\nclasses: {0: grass}\n")
    with site.visit(curator, expected=["422"]) as page:
        page.goto("/sequences")
        page.get_by_role("link", name="Import a dataset").click()
        expect(page.get_by_role("heading", name="No imports yet")).to_be_visible()
        page.locator('input[name="archive"]').set_input_files(packed)
        expect(page.locator("#said")).to_contain_text("compressed by gzip")
        expect(page.get_by_role("button", name="Import", exact=True)).to_be_disabled()
        assert uploads(site.platform) == []
        page.locator('input[name="archive"]').set_input_files(tar)
        expect(page.locator("#said")).to_be_empty()
        page.reload()
        page.locator('input[name="archive"]').set_input_files(tar)
        expect(page.get_by_role("textbox", name="Name")).to_have_value("offroad")
        page.locator('input[name="classes"]').set_input_files(wrong)
        page.get_by_label("Add a second label set").check()
        page.get_by_text("Metadata for all sequences").click()
        page.get_by_label("Environment").fill("mountain")
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.locator("#said")).to_contain_text("0 is 'grass'; expected one of", timeout=120_000)
        page.locator('input[name="classes"]').set_input_files(classes)
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_role("heading", name="offroad")).to_be_visible(timeout=120_000)
        expect(page.get_by_text("reading tables")).to_be_visible()
        (made,) = imports(site.platform)
        assert (made.name, made.existing, made.sets_splits) == ("offroad", "add", False)
        assert made.facts["environment"] == "mountain"
        assert made.classes == {"name": "theirs", "classes": {"0": "free", "1": "T", "2": "P", "3": "N"}}
        assert [upload.state for upload in uploads(site.platform)] == ["consumed"], "it was sent once"
        _fail(site.platform, "DST-018", "v1.0-trainval/sample.json row 3 (token 00ff): row 1 has this token too")
        expect(page.locator(".finding")).to_contain_text("sample.json row 3 (token 00ff)", timeout=120_000)
        expect(page.locator(".finding code")).to_have_text("DST-018")
        page.goto("/imports")
        page.get_by_role("button", name="Delete the import of offroad").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="No imports yet")).to_be_visible()
    assert imports(site.platform) == []


def test_a_zip_that_the_server_sees_is_named_instead_of_sent(
    platform: Platform, browser: Browser, curator: Person, tmp_path: Path
) -> None:
    """What is stated goes with it, and of the chosen file nothing; a path that leads out is refused."""
    placed = having(platform, in_place={"folders": f"nas={tmp_path}"})
    with zipfile.ZipFile(tmp_path / "STONE.zip", "w") as archive:
        archive.writestr("v1.0-trainval/scene.json", "[]")
    with serving(placed, make_site(placed)) as url:  # noqa: SIM117
        with Site(url, placed, browser).visit(curator, expected=["422"]) as page:
            page.goto("/imports")
            page.locator('input[name="archive"]').set_input_files(tmp_path / "STONE.zip")
            expect(page.locator("#chosen")).to_have_text("STONE.zip")
            expect(page.locator("#said")).to_be_empty()
            page.get_by_label("Path below it").fill("../STONE.zip")
            page.get_by_text("Layout and grid").click()
            page.locator('select[name="layout"]').select_option("release")
            page.locator('select[name="grid"]').select_option("occ3d")
            look(page, "import-in-place")
            page.get_by_role("button", name="Import", exact=True).click()
            expect(page.locator("#said")).to_contain_text("not a path within a root")
            page.get_by_label("Path below it").fill("STONE.zip")
            page.get_by_role("button", name="Import", exact=True).click()
            expect(page.get_by_role("heading", name="STONE")).to_be_visible()
            expect(page.get_by_text("nas:STONE.zip")).to_be_visible()
    (made,) = imports(placed)
    assert (made.place["path"], made.name, made.stated["layout"]) == ("STONE.zip", "STONE", "release")
    assert uploads(placed) == []


def _fail(platform: Platform, code: str, sentence: str) -> None:
    """As the job that reads the tables would have it."""
    with platform.database.transaction() as session:
        run = session.scalars(select(Job).where(Job.kind == "dataset.import")).one()
        for job in session.scalars(select(Job).where(Job.root_id == run.id)):
            job.state, job.failure_code, job.failure = "failed", code, sentence
            job.finished_ns = now_ns()


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
        drop(page, broken)
        result = page.locator(".transfer").filter(has_text="broken.yaml")
        expect(result.locator(".state")).to_have_text("refused")
        expect(result.locator(".finding code")).to_contain_text("CAL-4")
        expect(result.locator(".finding")).to_contain_text("the limit is 100 m")
        for path in (good, second):
            drop(page, path)
            expect(page.locator(".transfer").filter(has_text=path.name).locator(".state")).to_have_text("added")
        expect(page.locator("#calibrations tbody tr")).to_have_count(2)
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
