"""The participant's journeys: from the team to the form and the board; a refusal told file by file, in its words."""

import io
import re
import shlex
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from playwright.sync_api import Page, expect
from sqlalchemy import select

from api.schemas.submissions import FileProblem
from services.domain.benchmarks.starter import starter_code
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.teams.teams import enter
from services.runtime.orm import Phase, SubmissionRow
from services.runtime.platform import Platform
from stone_client.main import app
from stone_submissions.errors import MISTAKES
from testing.api.serving import Person, person
from testing.web.browsing import Site
from testing.web.reading import Reading
from testing.worlds.benchmark_world import World, predicted, run_eval, submission_zip
from testing.worlds.sending import send, standing_world
from tests.services.domain.benchmarks import laid
from tests.web.looking import look, serious_findings
from web.boards.submission_steps import StepsPlace, submission_steps
from web.problem_words import ADVICE, UNKNOWN, grouped

ROOT = Path(__file__).resolve().parents[2]

FRAMES = 4
"""Of a phase: two of each of its two sequences."""


@pytest.fixture
def world(tmp_path: Path, _sqlite_template: Path) -> Iterator[World]:
    with standing_world(tmp_path, _sqlite_template, frames=2) as made:
        yield made


@pytest.fixture
def platform(world: World) -> Platform:
    return world.platform


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


def test_a_team_sends_predictions_once_and_finds_them_on_the_board(site: Site, world: World, tmp_path: Path) -> None:
    archive = submission_zip(tmp_path / "run.zip", predicted(world.truth("val"), 0.1))
    with site.visit(world.captains[0]) as page:
        for _ in range(2):
            page.goto(form_of(world))
            fill(page, archive)
            expect(
                page.get_by_text(f"All {FRAMES} frames are present, with the right shape, type and values.")
            ).to_be_visible()
            page.get_by_role("button", name="Submit for scoring").dblclick()
            page.wait_for_url("**/submissions/*")
        expect(page.get_by_text("This file was already submitted")).to_be_visible()
        page.get_by_role("button", name="Edit").click()
        page.get_by_role("textbox", name="Description").fill("Now with <b>more</b> cameras.")
        page.get_by_role("button", name="Save").click()
        expect(page.locator(".prose")).to_have_text("Now with <b>more</b> cameras.")
        expect(page.get_by_text("Next in the queue")).to_be_visible()
        run_eval(site.platform)
        expect(page.get_by_text("Scored, and on the leaderboard.")).to_be_visible()
        expect(page.locator("#submission")).not_to_have_attribute("data-refresh", "4s")
        page.goto("/submissions")
        expect(page.get_by_role("listitem").filter(has_text="OccFormer-T")).to_contain_text("scored")
        page.get_by_role("link", name="OccFormer-T").click()
        page.get_by_role("link", name="View results").click()
        expect(page.get_by_role("heading", name="OccFormer-T")).to_be_visible()
        page.goto(form_of(world).removesuffix("/submit"))
        expect(page.get_by_role("link", name="OccFormer-T").first).to_be_visible()
    [row] = sent(world)
    assert (row.state, row.kind, row.modality) == ("scored", "entry", "C+L")


def test_a_zip_that_lacks_frames_is_refused_before_a_byte_is_sent(site: Site, world: World, tmp_path: Path) -> None:
    tokens = list(world.truth("val"))
    grids = {"floats": np.zeros((4, 4)), "turned": np.zeros((32, 256, 256), np.uint8)}
    made = {name: zipped(tmp_path / f"{name}.zip", dict.fromkeys(tokens, grid)) for name, grid in grids.items()}
    unknown = np.full((256, 256, 32), 255, np.uint8)
    mixed = {**dict.fromkeys(tokens, np.zeros_like(unknown)), tokens[-1]: unknown}
    made["mixed"] = zipped(tmp_path / "mixed.zip", mixed)
    archive = zipped(tmp_path / "run.zip", dict.fromkeys(tokens[1:], unknown))
    with zipfile.ZipFile(archive, "a") as extended:
        extended.writestr("notes.txt", "never mind")
    for name, content in (("half", archive.read_bytes()[: archive.stat().st_size // 2]), ("no", b"this is no zip" * 9)):
        made[name] = tmp_path / f"{name}.zip"
        made[name].write_bytes(content)
    with site.visit(world.captains[0]) as page:
        page.goto(form_of(world))
        fill(page, archive)
        expect(page.get_by_text(f"{FRAMES - 1} of {FRAMES} frames are present.")).to_be_visible()
        expect(page.get_by_text(f"{FRAMES - 1} frames with values beyond 3")).to_be_visible()
        page.get_by_text("1 missing frame").click()
        expect(page.locator(".found-list code")).to_have_count(2 + FRAMES - 1)
        expect(page.get_by_role("button", name="Submit for scoring")).to_be_disabled()
        assert serious_findings(page) == []
        for name, said in (
            ("no", "This cannot be read as a submission."),
            ("floats", f"{FRAMES} frames of wrong type"),
            ("turned", f"{FRAMES} frames of wrong shape"),
            ("mixed", "1 frame with values beyond 3"),
            ("half", "The zip was cut short or damaged"),
        ):
            page.locator("#file").set_input_files(made[name])
            expect(page.get_by_text(said)).to_be_visible()
            expect(page.get_by_text("would be rejected")).to_be_visible()
            expect(page.get_by_role("button", name="Submit for scoring")).to_be_disabled()
            if name == "turned":
                look(page, "submission-of-another-shape")
                page.get_by_text(said).click()
                expect(page.get_by_text("transpose(1, 2, 0)")).to_be_visible()
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
        expect(page.get_by_text(f"0 of {FRAMES} frames are present.")).to_be_visible()
        page.goto(form_of(world))
        fill(page, archive)
        expect(page.get_by_text("would be rejected")).to_be_visible()
        submission_id = send(world, archive.read_bytes(), kind="validation")  # as the API takes it
        run_eval(site.platform)
        page.goto(f"/submissions/{submission_id}")
        expect(page.get_by_text("2 problems in its file")).to_be_visible()
        for code, token in zip(("label out of range", "bad shape"), tokens, strict=True):
            table = page.get_by_role("region", name=code)
            expect(table.get_by_role("row")).to_have_count(2)
            expect(table.get_by_role("row").last).to_contain_text(f"run/{token}.npz")
        expect(page.get_by_role("region", name="label out of range")).to_contain_text("255")
        expect(page.get_by_text("grid.transpose(1, 2, 0) if your axes are z, x, y")).to_be_visible()
        assert page.get_by_text("does not count towards the quota").is_visible()
    [row] = sent(world)
    assert (row.state, row.kind) == ("invalid", "validation")


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
        page.locator("#file").set_input_files(archive)
        expect(page.get_by_label("Method name")).to_have_value("Half sent")
        expect(page.get_by_label("Cameras")).to_be_checked()
        page.get_by_role("button", name="Submit for scoring").click()
        expect(page.get_by_text("Next in the queue")).to_be_visible()
    assert [(row.state, row.method) for row in sent(world)] == [("queued", "Half sent")]


def limited(world: World, part: str, a_window: int) -> None:
    """The first team takes part in the phase; one of a window's scorings is used, another under way."""
    phase_id, team_id, captain_id = world.phase(part), world.teams[0], world.captains[0].user_id
    one, other = (laid.entry(world.platform, phase_id, team_id, captain_id) for _ in range(2))
    with world.platform.database.transaction() as session:
        phase = session.get_one(Phase, phase_id)
        phase.scorings_per_window, phase.scorings_total = a_window, 20
        enter(session, phase, team_id)
        scoring_quota.reserve(session, phase, team_id, one)
        scoring_quota.consume(session, one)
        scoring_quota.reserve(session, phase, team_id, other)


def test_a_team_reads_what_it_may_still_have_scored_and_where_it_may_submit(reading: Reading, world: World) -> None:
    limited(world, "test", 3)
    captain, participant = world.captains[0], person(world.platform, "participant")
    with world.platform.database.transaction() as session:
        phase = session.get_one(Phase, world.test)
        scoring_quota.grant(session, phase, world.teams[0], 1, "a day was lost")
    assert "2 of 4 submissions left" in reading.text(f"/teams/{world.teams[0]}", captain)
    team = reading.html(f"/teams/{world.teams[0]}", captain)
    assert 'aria-label="1 used, 1 in progress, 2 left"' in team
    assert 'id="submit"' in reading.html(form_of(world, "test"), captain)
    assert 'id="submit"' not in reading.html(form_of(world, "test"), participant)
    with world.platform.database.transaction() as session:
        phase = session.get_one(Phase, world.test)
        phase.opens_ns, phase.closes_ns = 1, 2
    assert 'id="submit"' not in reading.html(form_of(world, "test"), captain)


def test_a_team_is_founded_entered_by_invitation_and_handed_over(site: Site, participant: Person) -> None:
    guest = person(site.platform, "participant")
    with site.visit(participant) as page:
        page.goto("/teams")
        page.get_by_label("Name").fill("Terrain Gang")
        page.get_by_role("button", name="Create team").click()
        expect(page.get_by_role("heading", name="Terrain Gang")).to_be_visible()
        where = page.url
        page.get_by_role("button", name="Create invitation").click()
        expect(page.get_by_label("Invitation", exact=True)).to_have_value(re.compile("invite_"))
        secret = page.get_by_label("Invitation", exact=True).input_value()
        expect(page.locator("#invitations li")).to_have_count(1)
    assert re.fullmatch(r"invite_[A-Za-z0-9_-]{43}", secret)
    with site.visit(guest) as page:
        page.goto(f"/teams#{secret}")
        expect(page.get_by_label("Invitation")).to_have_value(secret)
        assert secret not in page.url
        page.get_by_role("button", name="Join").click()
        expect(page.get_by_role("heading", name="Terrain Gang")).to_be_visible()
        expect(page.get_by_role("button", name="Create invitation")).to_have_count(0)
    with site.visit(participant) as page:
        page.goto(where)
        page.get_by_role("button", name="Make captain").click()
        page.get_by_role("dialog").get_by_role("button", name="Make captain").click()
        expect(page.get_by_text(f"captain {guest.name}")).to_be_visible()
        page.get_by_role("button", name="Leave", exact=True).click()
        page.locator("dialog[open]").get_by_role("button", name="Leave").click()
        expect(page.locator("main").get_by_text("Terrain Gang")).to_have_count(0)


def problem(code: str, file: str) -> FileProblem:
    return FileProblem(code=code, file=file, frame=None, expected="a", actual="b")


def test_every_refusal_of_a_file_has_words_and_no_words_are_left_over() -> None:
    assert set(MISTAKES) == set(ADVICE)


def test_problems_stand_in_groups_the_largest_first_each_as_it_was_found() -> None:
    found = [problem("bad_shape", "1"), problem("bad_dtype", "2"), problem("news", "3"), problem("bad_dtype", "4")]
    groups = grouped(found)
    assert [(group.code, [one.file for one in group.problems]) for group in groups] == [
        ("bad_dtype", ["2", "4"]),
        ("bad_shape", ["1"]),
        ("news", ["3"]),
    ]
    assert groups[2].advice == UNKNOWN
    assert grouped([]) == []


@pytest.mark.parametrize("team", [None, "Terrain 'Gang' & Co", 'a "b" $HOME; rm'])
def test_every_line_is_a_command_with_options_that_exist(
    team: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for written in ("stone-val.manifest.json", "run.zip"):  # by the steps before
        (tmp_path / written).touch()
    lines = [step.line for step in submission_steps(StepsPlace("https://stone.test", None, "stone", "val", team))]
    ours = [shlex.split(line) for line in lines if line.startswith("stone ")]
    assert len(ours) == (5 if team else 6), "a team that exists is not created"
    assert [words for words in ours if (team or "My team") in words][-1][:3] == ["stone", "benchmark", "submit"]
    for words in ours:
        parsed(typer.main.get_command(app), words[1:])


def parsed(command: Any, words: list[str]) -> None:
    """Parse the words as the command would, below its groups; nothing is run. Raises what the command's parser does."""
    while hasattr(command, "commands"):
        command, words = command.commands[words[0]], words[1:]
    command.make_context(command.name, list(words))


def test_the_starter_code_is_what_the_docs_print() -> None:
    docs = (ROOT / "docs" / "participant.md").read_text("utf-8")
    block = re.search(r"```python\n(# predict\.py:.*?)```", docs, re.DOTALL)
    assert block is not None
    assert starter_code().decode() == block[1]
