"""Bags come in at a page: chosen, counted, sent, read; refused with reasons where they cannot."""

import shutil
from pathlib import Path

import httpx
from playwright.sync_api import expect
from sqlalchemy import select

from services.ingest.stages import handlers
from services.runtime.orm import CalibrationRow, SequenceRow
from simulator.pipeline import calibration_path
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from testing.worlds.ros1_bags import as_ros1
from tests.stone_recordings.splitting import split_into
from tests.web.bringing import bag, choose, recordings, row_of, uploads
from tests.web.looking import look
from tests.web.test_calibrations import moved
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
    with site.visit(curator, expected=["422"]) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        look(page, "sequences-new-empty")
        page.locator("[data-folder]").set_input_files(tmp_path / "field day")
        expect(page.locator(".transfer")).to_have_count(3)
        expect(row_of(page, "run 7").get_by_label("Sequence")).to_have_value("run-7")
        row_of(page, "alone.mcap").get_by_label("Sequence").fill("hill-3")
        page.get_by_label("Environment").select_option("mountain")
        expect(page.get_by_text("2 files were left out")).to_be_visible()
        expect(page.locator("[data-left-list]")).to_contain_text("rig.yaml: Not a valid calibration. CAL-")
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
    junk.write_bytes(b"\x89MCAP0\r\n" + b"this is no recording " * 50)
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


def test_a_page_called_a_bag_is_refused_before_a_byte_of_it_is_sent(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    login = tmp_path / "run.mcap"
    login.write_text("<!DOCTYPE html><title>Sign in</title>" * 100)
    asked: list[str] = []
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        page.on("request", lambda request: asked.append(f"{request.method} {request.url}"))
        choose(page, login)
        row = row_of(page, "run.mcap")
        expect(row.locator("[data-phase]")).to_have_text("refused")
        expect(row.locator(".finding")).to_contain_text("BAG-001")
        expect(row.locator(".finding")).to_contain_text("looks like an HTML page")
        expect(row.get_by_role("button", name="Try again")).to_be_hidden()
        expect(page.get_by_role("button", name="Upload")).to_be_disabled()
        look(page, "sequences-new-no-bag")
        row.get_by_role("button", name="Remove").click()
        expect(row).to_have_count(0)
    assert [one for one in asked if one.startswith(("POST", "PATCH"))] == []


def test_a_bag_and_its_calibration_come_in_one_drop(site: Site, curator: Person, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(bag(), folder / "run.mcap")
    shutil.copy(calibration_path(bag()), folder / "spot.yaml")
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        process = page.get_by_label("Process each sequence")
        expect(process).to_be_disabled()
        page.locator("[data-folder]").set_input_files(folder)
        expect(row_of(page, "spot.yaml").locator(".state")).to_have_text("added")
        expect(row_of(page, "spot.yaml")).to_contain_text("Assigned.")
        expect(process).to_be_checked()
        look(page, "sequences-new-calibrated")
        page.get_by_role("button", name="Upload").click()
        expect(row_of(page, "run.mcap").locator("[data-phase]")).to_have_text("reading")
    with site.platform.database.reading() as session:
        kept = session.scalars(select(CalibrationRow)).one()
        assert session.scalars(select(SequenceRow)).one().calibration_id == kept.id


def test_a_calibration_that_is_dropped_at_a_sequence_is_assigned_unless_it_has_one(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    own = calibration_path(bag())
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator) as page:
        page.goto(f"/sequences/{made['id']}")
        choose(page, own)
        expect(row_of(page, own.name)).to_contain_text("Assigned.")
        expect(page.locator("#calibration")).not_to_contain_text("No calibration assigned")
        page.reload()
        choose(page, moved(own, tmp_path / "other.yaml", 0.01))
        expect(row_of(page, "other.yaml")).to_contain_text("Not assigned")
    with site.platform.database.reading() as session:
        first, _ = session.scalars(select(CalibrationRow).order_by(CalibrationRow.id)).all()
        assert session.scalars(select(SequenceRow)).one().calibration_id == first.id


def test_a_calibration_that_cannot_be_assigned_is_added_and_says_why(site: Site, curator: Person) -> None:
    """Catches alone a line that goes on saying that the file is read."""
    problem = '{"title": "Conflict", "status": 409, "detail": "it is being deleted", "code": "x", "request_id": ""}'
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator, expected=["409"]) as page:
        page.goto(f"/sequences/{made['id']}")
        page.route(
            "**/calibration",
            lambda route: route.fulfill(status=409, content_type="application/problem+json", body=problem),
        )
        choose(page, calibration_path(bag()))
        line = row_of(page, calibration_path(bag()).name)
        expect(line.locator(".state")).to_have_text("added")
        expect(line).to_contain_text("Not assigned: it is being deleted")


def test_no_robots_calibration_is_chosen_but_the_one_last_used_with_it(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    with httpx.Client(base_url=site.url, headers=curator.headers) as api:
        ids = {}
        for robot, by_m in (("spot", 0.01), ("husky", 0.02)):
            path = moved(calibration_path(bag()), tmp_path / f"{robot}.yaml", by_m)
            ids[robot] = api.post("/api/v1/calibrations", files={"file": (path.name, path.read_bytes())}).json()["id"]
            made = sequence(api, curator, f"run-{robot}", platform=robot)
            api.put(f"/api/v1/sequences/{made['id']}/calibration", json={"calibration_id": ids[robot]})
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        calibration = page.get_by_label("Calibration", exact=False).and_(page.locator("select"))
        expect(calibration).to_have_value("")
        page.get_by_label("Robot").fill("spot")
        expect(calibration).to_have_value(ids["spot"])
        expect(page.get_by_text("last used with spot")).to_be_visible()
        look(page, "sequences-new-robot")
        page.get_by_label("Robot").fill("another")
        expect(calibration).to_have_value("")
        calibration.select_option(ids["husky"])
        page.get_by_label("Robot").fill("spot")
        expect(calibration).to_have_value(ids["husky"])


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
        expect(page.get_by_role("link", name="Upload recordings")).to_have_count(0)
        answer = page.goto("/sequences/new")
        assert answer is not None
        assert answer.status == 403
