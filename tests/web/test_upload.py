"""Bags come in at a page: chosen, counted, sent, read; refused with reasons where they cannot."""

import shutil
from pathlib import Path

import httpx
from playwright.sync_api import expect

from services.ingest.stages import handlers
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from testing.worlds.ros1_bags import as_ros1
from tests.stone_recordings.splitting import split_into
from tests.web.bringing import bag, choose, recordings, row_of, uploads
from tests.web.looking import look
from tests.working import working

CALIBRATION = Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml"


def test_bags_of_several_kinds_become_sequences_of_their_own(site: Site, curator: Person, tmp_path: Path) -> None:
    split = tmp_path / "field day" / "run 7"
    split.mkdir(parents=True)
    split_into(bag(), split, 3)
    shutil.copy(bag(), tmp_path / "field day" / "alone.mcap")
    as_ros1(bag(), tmp_path / "field day" / "older.bag", "lz4")
    (tmp_path / "field day" / "rig.yaml").write_text("sensors: {}")
    (tmp_path / "field day" / "notes.txt").write_text("windy")
    with site.visit(curator) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        look(page, "sequences-new-empty")
        page.locator("[data-folder]").set_input_files(tmp_path / "field day")
        expect(page.locator(".transfer")).to_have_count(3)
        expect(row_of(page, "run 7").get_by_label("Sequence")).to_have_value("run-7")
        row_of(page, "alone.mcap").get_by_label("Sequence").fill("hill-3")
        page.get_by_label("Environment").select_option("mountain")
        page.get_by_text("2 files were left out").click()
        expect(page.locator("[data-left-list]")).to_contain_text("A calibration goes to the calibrations")
        look(page, "sequences-new-chosen")
        page.get_by_role("button", name="Upload 3 bags").click()
        for name in ("run 7", "alone.mcap", "older.bag"):
            expect(row_of(page, name).locator("[data-phase]")).to_have_text("registered", timeout=300_000)
        look(page, "sequences-new-done")
        row_of(page, "alone.mcap").get_by_role("link", name="Open the sequence").click()
        expect(page.get_by_role("heading", name="hill-3")).to_be_visible()
    kept = {row.filename: [file.filename for file in row.files] for row in recordings(site.platform)}
    assert len(kept.pop("run 7")) >= 3
    assert kept == {"alone.mcap": ["alone.mcap"], "older.bag": ["older.bag"]}


def test_bags_that_are_given_one_name_become_one_sequence(site: Site, curator: Person, tmp_path: Path) -> None:
    lidar, cameras = (shutil.copy(bag(), tmp_path / name) for name in ("lidar.mcap", "cameras.mcap"))
    with site.visit(curator) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        page.locator("[data-files]").set_input_files([lidar, cameras])
        for name in ("lidar.mcap", "cameras.mcap"):
            row_of(page, name).get_by_label("Sequence").fill("hill-4")
        page.get_by_role("button", name="Upload 2 bags").click()
        for name in ("lidar.mcap", "cameras.mcap"):
            expect(row_of(page, name).locator("[data-phase]")).to_have_text("registered", timeout=300_000)
    assert {row.filename for row in recordings(site.platform)} == {"lidar.mcap", "cameras.mcap"}
    assert len({row.sequence_id for row in recordings(site.platform)}) == 1


def test_what_cannot_be_taken_says_why_beside_its_line(site: Site, curator: Person, tmp_path: Path) -> None:
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"this is no recording " * 50)
    with httpx.Client(base_url=site.url) as api:
        sequence(api, curator, "junk")
    expected = ["409"]
    with site.visit(curator, expected=expected) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        choose(page, junk)
        page.get_by_role("button", name="Upload").click()
        row = row_of(page, "junk.mcap")
        expect(row.locator(".finding")).to_contain_text("name_taken")
        look(page, "sequences-new-name-taken")
        row.get_by_label("Sequence").fill("junk-2")
        row.get_by_role("button", name="Try again").click()
        expect(row.locator("[data-phase]")).to_have_text("refused", timeout=300_000)
        expect(row.locator(".finding").first).to_contain_text("BAG-")
        look(page, "sequences-new-refused")
    assert [row.state for row in recordings(site.platform)] == ["refused"]


def test_the_same_bag_is_neither_sent_nor_kept_twice(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator) as page, working(site.platform, "ingest", handlers):
        for _ in range(2):
            page.goto(f"/sequences/new?again={_}")
            page.goto(f"/sequences/{made['id']}/recordings")
            choose(page, bag())
            expect(row_of(page, "run.mcap").locator("[data-phase]")).to_have_text("registered", timeout=300_000)
    assert len(recordings(site.platform)) == len(uploads(site.platform)) == 1


def test_a_participant_has_no_way_in(site: Site, participant: Person) -> None:
    with site.visit(participant, expected=["403"]) as page:
        page.goto("/sequences")
        expect(page.get_by_role("link", name="Bring new ones")).to_have_count(0)
        answer = page.goto("/sequences/new")
        assert answer is not None
        assert answer.status == 403
