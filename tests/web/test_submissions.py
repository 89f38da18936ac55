"""The participant's journeys: from the form to the board, and a refusal told file by file."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import select

from services.runtime.orm import SubmissionRow
from services.runtime.platform import Platform
from testing.web.browsing import Site
from testing.worlds.benchmark_world import World, benchmark_world, predicted, run_eval, submission_zip
from tests.web.looking import look

FLOATS = np.zeros((4, 4))


@pytest.fixture
def world(platform: Platform) -> World:
    return benchmark_world(platform)


def form_of(world: World, part: str = "val") -> str:
    return f"/benchmarks/{world.benchmark}/{part}/submit"


def fill(page: Page, path: Path, method: str = "OccFormer-T") -> None:
    """The form, up to what sends it."""
    page.locator("#file").set_input_files(path)
    page.get_by_label("Method name").fill(method)
    page.get_by_label("LiDAR").check()
    page.get_by_label("Cameras").check()


def zipped(path: Path, frames: Mapping[str, Any], folder: str = "") -> Path:
    """As `submission_zip`, of whatever arrays."""
    with zipfile.ZipFile(path, "w") as packed:
        for token, grid in frames.items():
            content = io.BytesIO()
            np.savez_compressed(content, semantics=grid)
            packed.writestr(f"{folder}{token}.npz", content.getvalue())
    return path


def sent(world: World) -> list[SubmissionRow]:
    with world.platform.database.reading() as session:
        return list(session.scalars(select(SubmissionRow).order_by(SubmissionRow.id)))


def test_a_team_sends_predictions_and_finds_them_on_the_board(site: Site, world: World, tmp_path: Path) -> None:
    archive = submission_zip(tmp_path / "run.zip", predicted(world.truth("val"), 0.1))
    with site.visit(world.captains[0]) as page:
        page.goto("/submissions")
        look(page, "submissions-empty")
        page.goto(form_of(world))
        look(page, "submit")
        fill(page, archive)
        expect(page.get_by_text("All 8 frames are present.")).to_be_visible()
        page.get_by_label("Description").fill("Trained on train only.\nTwo cameras fewer.")
        look(page, "submit-ready")
        page.get_by_role("button", name="Submit for scoring").dblclick()
        expect(page.get_by_text("Next in the queue")).to_be_visible()
        look(page, "submission-queued")
        run_eval(site.platform)
        expect(page.get_by_text("Scored, and on the leaderboard.")).to_be_visible()
        expect(page.locator("#submission")).not_to_have_attribute("data-refresh", "4s")
        expect(page.get_by_text("mIoU")).to_be_visible()
        look(page, "submission-scored")
        page.goto("/submissions")
        expect(page.get_by_role("listitem").filter(has_text="OccFormer-T")).to_contain_text("scored")
        look(page, "submissions")
        page.get_by_role("link", name="OccFormer-T").click()
        page.get_by_role("link", name="View results").click()
        expect(page.get_by_role("heading", name="OccFormer-T")).to_be_visible()
        page.goto(form_of(world).removesuffix("/submit"))
        expect(page.get_by_role("link", name="OccFormer-T").first).to_be_visible()
    [row] = sent(world)
    assert (row.state, row.kind, row.modality) == ("scored", "entry", "C+L")
    assert row.description == "Trained on train only.\nTwo cameras fewer."


def test_a_zip_that_lacks_frames_is_refused_before_a_byte_is_sent(site: Site, world: World, tmp_path: Path) -> None:
    frames = predicted(world.truth("val"), 0.1)
    for token in list(frames)[2:5]:
        del frames[token]
    spoilt = dict.fromkeys(frames, np.full((256, 256, 32), 255, np.uint8))  # all there, and all wrong inside
    archive = zipped(tmp_path / "run.zip", spoilt)
    with zipfile.ZipFile(archive, "a") as extended:
        extended.writestr("notes.txt", "never mind")
    with site.visit(world.captains[0]) as page:
        page.goto(form_of(world))
        fill(page, archive)
        expect(page.get_by_text("5 of 8 frames are present. What is in them is checked after sending.")).to_be_visible()
        page.get_by_text("3 missing frames").click()
        expect(page.locator(".found-list code")).to_have_count(4)
        expect(page.get_by_role("button", name="Submit for scoring")).to_be_disabled()
        expect(page.get_by_text("Fix the zip first")).to_be_visible()
        look(page, "submit-incomplete")
        (tmp_path / "no.zip").write_bytes(b"this is no zip" * 100)
        page.locator("#file").set_input_files(tmp_path / "no.zip")
        expect(page.get_by_text("This cannot be read as a submission.")).to_be_visible()
        page.locator("#file").set_input_files(
            zipped(tmp_path / "floats.zip", dict.fromkeys(world.truth("val"), FLOATS))
        )
        expect(page.get_by_text("All 8 frames are present.")).to_be_visible()
        expect(page.get_by_text("The first frame was looked into: bad dtype")).to_contain_text("'<f8'")
        look(page, "submit-warned")
        turned = zipped(tmp_path / "turned.zip", dict.fromkeys(world.truth("val"), np.zeros((32, 256, 256), np.uint8)))
        page.locator("#file").set_input_files(turned)
        expect(page.get_by_text("The first frame was looked into: bad shape")).to_contain_text("transpose(1, 2, 0)")
        half = tmp_path / "half.zip"
        half.write_bytes(archive.read_bytes()[: archive.stat().st_size // 2])
        page.locator("#file").set_input_files(half)
        expect(page.get_by_text("The zip was cut short or damaged")).to_be_visible()
        look(page, "submit-cut-short")
    assert sent(world) == []


def test_what_is_wrong_inside_of_files_is_told_file_by_file(site: Site, world: World, tmp_path: Path) -> None:
    frames: dict[str, Any] = dict(predicted(world.truth("val"), 0.1))
    tokens = list(frames)[:2]
    frames |= dict(
        zip(tokens, (np.full((256, 256, 32), 255, np.uint8), np.zeros((32, 256, 256), np.uint8)), strict=True)
    )
    archive = zipped(tmp_path / "run.zip", frames, "run/")
    with site.visit(world.captains[0]) as page:
        page.goto(form_of(world, "test"))
        fill(page, archive)
        expect(page.get_by_text("0 of 8 frames are present.")).to_be_visible()
        page.goto(form_of(world))
        fill(page, archive)
        page.get_by_role("button", name="Validate only").click()
        expect(page.get_by_text("Next in the queue")).to_be_visible()
        run_eval(site.platform)
        expect(page.get_by_text("2 problems in its file")).to_be_visible()
        for code, token in zip(("label out of range", "bad shape"), tokens, strict=True):
            table = page.get_by_role("region", name=code)
            expect(table.get_by_role("row")).to_have_count(2)
            expect(table.get_by_role("row").last).to_contain_text(f"run/{token}.npz")
        expect(page.get_by_role("region", name="label out of range")).to_contain_text("255")
        expect(page.get_by_text("grid.transpose(1, 2, 0) if its axes are z, x, y")).to_be_visible()
        look(page, "submission-refused")
        assert page.get_by_text("does not count towards the quota").is_visible()
    [row] = sent(world)
    assert (row.state, row.kind) == ("invalid", "validation")


def test_the_same_file_is_not_sent_twice(site: Site, world: World, tmp_path: Path) -> None:
    archive = submission_zip(tmp_path / "run.zip", predicted(world.truth("val"), 0.1))
    with site.visit(world.captains[0]) as page:
        for _ in range(2):
            page.goto(form_of(world))
            fill(page, archive)
            page.get_by_role("button", name="Submit for scoring").click()
            page.wait_for_url("**/submissions/*")
        expect(page.get_by_text("This file was already submitted")).to_be_visible()
        page.get_by_role("button", name="Edit").click()
        page.get_by_role("textbox", name="Description").fill("Now with <b>more</b> cameras.")
        page.get_by_role("button", name="Save").click()
        expect(page.locator(".prose")).to_have_text("Now with <b>more</b> cameras.")
        page.get_by_role("button", name="Cancel").click()
        page.get_by_role("button", name="Cancel it").click()
        expect(page.locator("#submission").get_by_text("Cancelled", exact=True).first).to_be_visible()
    assert [row.state for row in sent(world)] == ["cancelled"]


def test_a_page_that_was_left_while_sending_goes_on_where_it_was(site: Site, world: World, tmp_path: Path) -> None:
    archive = submission_zip(tmp_path / "run.zip", predicted(world.truth("val"), 0.1))
    with site.visit(world.captains[0], expected=["ERR_FAILED", "500"]) as page:
        page.goto(form_of(world))
        fill(page, archive, "Half sent")
        page.route(
            "**/uploads/*", lambda route: route.abort() if route.request.method == "PATCH" else route.continue_()
        )
        page.get_by_role("button", name="Submit for scoring").click()
        expect(page.get_by_text("Uploading", exact=True)).to_be_visible()
        page.get_by_role("button", name="Stop").click()
        expect(page.get_by_text("Uploaded data is kept")).to_be_visible()
        page.unroute("**/uploads/*")
        page.reload()
        expect(page.get_by_role("heading", name="Unfinished: Half sent")).to_be_visible()
        look(page, "submit-unfinished")
        page.locator("#file").set_input_files(archive)
        expect(page.get_by_label("Method name")).to_have_value("Half sent")
        expect(page.get_by_label("Cameras")).to_be_checked()
        page.get_by_role("button", name="Submit for scoring").click()
        expect(page.get_by_text("Next in the queue")).to_be_visible()
    assert [(row.state, row.method) for row in sent(world)] == [("queued", "Half sent")]


def test_a_submission_of_others_has_no_page(site: Site, world: World, tmp_path: Path) -> None:
    archive = submission_zip(tmp_path / "run.zip", predicted(world.truth("val"), 0.1))
    with site.visit(world.captains[0]) as page:
        page.goto(form_of(world))
        fill(page, archive)
        page.get_by_role("button", name="Submit for scoring").click()
        page.wait_for_url("**/submissions/*")
        where = page.url
    with site.visit(world.captains[1], expected=["404"]) as page:
        answer = page.goto(where)
        assert answer is not None
        assert answer.status == 404
    with site.visit(world.member) as page:
        page.goto(where)
        expect(page.get_by_role("button", name="Cancel")).to_be_visible()
