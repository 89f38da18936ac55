"""A dataset comes in at a page: chosen, counted, sent, watched; refused with file, row and token where it is wrong."""

import gzip
from hashlib import sha256
from pathlib import Path

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from services.ingest import stages as ingest
from services.labeler import stages as labeler
from services.runtime.orm import DatasetImport, Job
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.stone_serve import until
from testing.web.browsing import PATIENCE_MS, Site
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from tests.web.bringing import slow_down, uploads
from tests.web.looking import keep, look
from tests.working import working

GOOD = SyntheticDataset(labels=(made_labels(1),), splits={"train": ["field-0000"], "val": ["field-0001"]})


@pytest.fixture
def tar(tmp_path: Path) -> Path:
    return write_published_tar(tmp_path / "offroad.tar", GOOD)


def imports(platform: Platform) -> list[DatasetImport]:
    with platform.database.reading() as session:
        return list(session.scalars(select(DatasetImport).order_by(DatasetImport.id)))


def test_a_tar_is_sent_and_its_import_is_watched(site: Site, curator: Person, tar: Path, tmp_path: Path) -> None:
    (tmp_path / "classes.yaml").write_text("name: theirs\nclasses: {0: free, 1: T, 2: P, 3: N}\n")
    with site.visit(curator) as page:
        page.goto("/sequences")
        page.get_by_role("link", name="Import a dataset").click()
        expect(page.get_by_role("heading", name="No imports yet")).to_be_visible()
        look(page, "imports-empty")
        page.locator('input[name="tar"]').set_input_files(tar)
        expect(page.get_by_role("textbox", name="Name")).to_have_value("offroad")
        page.locator('input[name="classes"]').set_input_files(tmp_path / "classes.yaml")
        page.get_by_label("Add a second label set").check()
        page.get_by_text("Metadata for all sequences").click()
        page.get_by_label("Environment").select_option("mountain")
        look(page, "imports-chosen")
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_role("heading", name="offroad")).to_be_visible(timeout=120_000)
        expect(page.get_by_text("reading tables")).to_be_visible()
        look(page, "imports-begun")
    (made,) = imports(site.platform)
    assert (made.name, made.existing, made.sets_splits) == ("offroad", "add", False)
    assert made.facts["environment"] == "mountain"
    assert made.classes == {"name": "theirs", "classes": {"0": "free", "1": "T", "2": "P", "3": "N"}}
    assert [upload.state for upload in uploads(site.platform)] == ["consumed"]


@pytest.mark.whole
def test_imported_sequences_are_looked_at_as_others_are_and_say_where_they_came_from(
    site: Site, curator: Person, tar: Path
) -> None:
    """Catches alone a page or a viewer that cannot show a sequence without a recording, a run and features."""
    with (
        site.visit(curator) as page,
        working(site.platform, "ingest", ingest.handlers),
        working(site.platform, "labeler", labeler.handlers),
    ):
        page.goto("/imports")
        page.locator('input[name="tar"]').set_input_files(tar)
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_text("2 sequences, 6 frames")).to_be_visible(timeout=PATIENCE_MS)
        look(page, "imports-done")
        page.get_by_role("link", name="field-0000").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("field-0000")
        expect(page.locator(".facts").first).to_contain_text(sha256(tar.read_bytes()).hexdigest())
        expect(page.locator(".facts").first).to_contain_text("offroad")
        expect(page.locator("[data-viewer]")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
        look(page, "imported-sequence")
        page.get_by_role("link", name="Processing").click()
        expect(page.get_by_role("heading", name="These labels were imported")).to_be_visible()
        expect(page.get_by_role("button", name="Start processing")).to_have_count(0)
        look(page, "imported-processing")
        page.get_by_role("link", name="Open in 3D").click()
        expect(page.locator("[data-viewer]")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
        keep(page, "imported-viewer")


def test_an_import_that_failed_says_where_and_is_forgotten_by_the_keyboard(
    site: Site, curator: Person, tar: Path
) -> None:
    with site.visit(curator) as page:
        page.goto("/imports")
        page.locator('input[name="tar"]').set_input_files(tar)
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_role("heading", name="offroad")).to_be_visible(timeout=120_000)
        _fail(site.platform, "DST-018", "v1.0-trainval/sample.json row 3 (token 00ff): row 1 has this token too")
        expect(page.locator(".finding")).to_contain_text("sample.json row 3 (token 00ff)", timeout=120_000)
        expect(page.locator(".finding code")).to_have_text("DST-018")
        look(page, "imports-failed")
        page.goto("/imports")
        look(page, "imports-list")
        page.get_by_role("button", name="Delete the import of offroad").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="No imports yet")).to_be_visible()
    assert imports(site.platform) == []


def test_a_compressed_tar_is_refused_before_a_byte_is_sent(site: Site, curator: Person, tar: Path) -> None:
    packed = tar.with_suffix(".tar.gz")
    packed.write_bytes(gzip.compress(tar.read_bytes()))
    with site.visit(curator) as page:
        page.goto("/imports")
        page.locator('input[name="tar"]').set_input_files(packed)
        expect(page.locator("#said")).to_contain_text("compressed by gzip")
        expect(page.get_by_role("button", name="Import", exact=True)).to_be_disabled()
        page.locator('input[name="tar"]').set_input_files(tar)
        expect(page.get_by_role("button", name="Import", exact=True)).to_be_enabled()
        expect(page.locator("#said")).to_be_empty()
    assert uploads(site.platform) == []


def test_a_class_map_that_is_none_is_refused_with_its_code_and_mended(
    site: Site, curator: Person, tar: Path, tmp_path: Path
) -> None:
    (tmp_path / "classes.yaml").write_text("name: theirs\nclasses: {0: grass}\n")
    with site.visit(curator, expected=["422"]) as page:
        page.goto("/imports")
        page.locator('input[name="tar"]').set_input_files(tar)
        page.locator('input[name="classes"]').set_input_files(tmp_path / "classes.yaml")
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.locator("#said")).to_contain_text("0 is 'grass', expected is one of", timeout=120_000)
        (tmp_path / "mended.yaml").write_text("name: theirs\nclasses: {0: free}\n")
        page.locator('input[name="classes"]').set_input_files(tmp_path / "mended.yaml")
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_role("heading", name="offroad")).to_be_visible(timeout=120_000)
    assert len(uploads(site.platform)) == len(imports(site.platform)) == 1, "it was sent once"


def test_what_was_stopped_goes_on_where_it_was(site: Site, curator: Person, tmp_path: Path) -> None:
    tar = tmp_path / "bulky.tar"
    tar.write_bytes(bytes(24 * 2**20))
    with site.visit(curator) as page:
        page.goto("/imports")
        slow_down(page, 4 * 2**20)
        page.locator('input[name="tar"]').set_input_files(tar)
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.locator("#sending-act")).to_have_text("Uploading", timeout=120_000)
        until(lambda: page.locator("#sending-bar").evaluate("bar => bar.value") > 0.1)
        look(page, "imports-sending")
        page.get_by_role("button", name="Stop").click()
        expect(page.locator("#said")).to_contain_text("start again to resume")
        slow_down(page, -1)
        page.goto("/imports")
        page.locator('input[name="tar"]').set_input_files(tar)
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_role("heading", name="bulky")).to_be_visible(timeout=120_000)
    assert [upload.state for upload in uploads(site.platform)] == ["consumed"]


def test_a_participant_has_no_way_in_and_others_see_nothing_of_it(
    site: Site, participant: Person, curator: Person, tar: Path
) -> None:
    with site.visit(participant, expected=["403"]) as page:
        answer = page.goto("/imports")
        assert answer is not None
        assert answer.status == 403
    with site.visit(curator) as page:
        page.goto("/imports")
        page.locator('input[name="tar"]').set_input_files(tar)
        page.get_by_role("button", name="Import", exact=True).click()
        expect(page.get_by_role("heading", name="offroad")).to_be_visible(timeout=120_000)
    (made,) = imports(site.platform)
    with site.visit(person(site.platform, "curator"), expected=["404"]) as page:
        page.goto("/imports")
        expect(page.get_by_role("heading", name="No imports yet")).to_be_visible()
        answer = page.goto(f"/imports/{made.id}")
        assert answer is not None
        assert answer.status == 404


def _fail(platform: Platform, code: str, sentence: str) -> None:
    """As the job that reads the tables would have it."""
    with platform.database.transaction() as session:
        run = session.scalars(select(Job).where(Job.kind == "dataset.import")).one()
        for job in session.scalars(select(Job).where(Job.root_id == run.id)):
            job.state, job.failure_code, job.failure = "failed", code, sentence
            job.finished_ns = now_ns()
