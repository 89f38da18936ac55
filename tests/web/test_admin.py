"""The administrator: steers jobs and queues with a reason, reads logs; re-scores, grants, sets rules and dates."""

import re
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import update

from benchmarks.dashboard.rows import fill
from services.domain.benchmarks.phases.reported_results import reported_in
from services.runtime.orm import Activation, AuditEntry, Benchmark, JobLine, Phase
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.sandbox import fences
from services.runtime.store.blobs import keep
from services.runtime.store.faults import note
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.web.reading import Reading
from testing.worlds.benchmark_world import World, benchmark_world
from testing.worlds.made import job, row_of
from tests.api.test_audit import unguarded
from tests.api.test_jobs import run_all
from tests.services.domain.benchmarks.scored import Place, another_truth, phase_of_rows, scored, scored_entry, team
from tests.web.looking import look


@pytest.fixture
def busy(platform: Platform) -> str:
    """A platform with work of all kinds; the id of a run that runs."""
    with platform.database.transaction() as session:
        return fill(session, runs=120, workers=20).running_id


def give_reason(page: Page, words: str, button: str) -> None:
    asking = page.get_by_role("dialog")
    asking.get_by_label("Reason").fill(words)
    asking.get_by_role("button", name=button).click()


def test_the_work_is_listed_by_state_and_owner_with_its_workers(
    reading: Reading, administrator: Person, busy: str
) -> None:
    jobs = reading.html("/admin/jobs", administrator)
    assert jobs.count('class="square"') == 20
    assert "worker_lost" in reading.html("/admin/jobs?list=dead", administrator)
    assert "worker_lost" not in reading.html("/admin/jobs?list=dead&owner=nobody", administrator)
    assert "worker-2:4719" in reading.html("/admin/queues", administrator)
    assert "Reconstruct the surface: 1 running" in reading.html(f"/admin/jobs/{busy}", administrator)


def test_damaged_objects_are_shown_with_what_needs_them(
    site: Site, reading: Reading, platform: Platform, administrator: Person, tmp_path: Path
) -> None:
    assert "damaged or lost" not in reading.html("/admin/queues", administrator)
    (tmp_path / "rig").write_bytes(b"rig")
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, tmp_path / "rig")
        note(session, blob, "bytes", "scrub")
    with site.visit(administrator) as page:
        page.goto("/admin/queues")
        expect(page.locator("#store")).to_contain_text("1 damaged or lost")
        expect(page.locator("#store")).to_contain_text(blob.object_key)
        look(page, "queues-damaged")


def test_the_installation_says_which_fence_of_the_sandbox_its_kernel_does_not_have(
    reading: Reading, administrator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fences, "version", lambda: 6)
    assert "landlock" not in reading.html("/admin/queues", administrator)
    monkeypatch.setattr(fences, "version", lambda: 2)
    assert "<code>landlock_without_signals</code>" in reading.html("/admin/queues", administrator)
    monkeypatch.setattr(fences, "version", lambda: 0)
    assert "<code>no_landlock</code>" in reading.html("/admin/queues", administrator)


def test_many_are_selected_and_steered_with_what_came_of_each(
    site: Site, platform: Platform, administrator: Person, curator: Person
) -> None:
    failed = [job(platform, curator, "ingest.refuse") for _ in range(3)]
    fine = job(platform, curator, "ingest.speak")
    run_all(platform)
    with site.visit(administrator) as page:
        page.goto("/admin/jobs")
        boxes = page.locator("[data-pick]")
        boxes.nth(0).focus()
        page.keyboard.press("Space")
        page.keyboard.press("Shift+ArrowDown")
        boxes.nth(3).click(modifiers=["Shift"])
        expect(page.locator("[data-picked-count]")).to_have_text("4")
        job(platform, curator, "ingest.speak")
        expect(page.locator("[data-pick]")).to_have_count(5)
        expect(page.locator("[data-pick]:checked")).to_have_count(4)
        page.get_by_role("button", name="Retry").click()
        expect(page.get_by_role("dialog")).to_contain_text("1 of the selected is left as it is")
        give_reason(page, "the disk was full", "Retry 3 jobs")
        expect(page.get_by_role("dialog")).to_be_hidden()
        expect(page.locator("[data-picked-count]")).to_have_text("1")
        for act in ("Retry", "Cancel", "Terminate"):
            expect(page.get_by_role("button", name=act, exact=True)).to_be_disabled()  # the one left has succeeded
        page.keyboard.press("Escape")
        expect(page.locator("[data-picked]")).to_be_hidden()
    assert [row_of(platform, one).state for one in failed] == ["queued"] * 3
    assert row_of(platform, fine).state == "succeeded"


def test_a_log_is_followed_until_one_scrolls_up(
    site: Site, platform: Platform, administrator: Person, curator: Person
) -> None:
    job_id = job(platform, curator, "ingest.refuse")
    say(platform, job_id, 0, 200)
    with site.visit(administrator) as page:
        page.goto(f"/admin/jobs/{job_id}")
        lines = page.get_by_role("log")
        lines.scroll_into_view_if_needed()
        expect(lines.get_by_text("line 199")).to_be_in_viewport()
        lines.evaluate("at => { at.scrollTop = 0 }")
        follow = page.get_by_role("button", name="Follow again")
        expect(follow).to_be_visible()
        say(platform, job_id, 200, 201)
        expect(page.get_by_text("201 lines")).to_be_visible()
        expect(lines.get_by_text("line 0", exact=True)).to_be_in_viewport()
        follow.click()
        expect(lines.get_by_text("line 200")).to_be_in_viewport()
        page.get_by_label("From level").select_option("error")
        expect(lines.get_by_text("line 150")).to_be_visible()
        expect(lines.get_by_text("line 200")).to_be_hidden()
        run_all(platform)
        expect(page.locator("#job")).to_have_attribute("data-state", "failed")
        expect(page.get_by_text("the bag is cut at byte 7").first).to_be_visible()
        page.get_by_label("From level").select_option("info")


def say(platform: Platform, job_id: str, first: int, end: int) -> None:
    """Lines of an attempt before the first, as a worker writes them; every fiftieth is an error."""
    with platform.database.transaction() as session:
        for number in range(first, end):
            level = "error" if number % 50 == 0 and number < 200 else "info"
            line = JobLine(job_id=job_id, attempt=0, number=number, level=level, event=f"line {number}")
            line.facts, line.logged_ns = {"tile": f"{number}_0"}, now_ns()
            session.add(line)


BEFORE = (0.52, 0.47, 0.44, 0.39, 0.31)
AFTER = (0.49, 0.51, 0.44, 0.36, 0.38)
TEAMS = ("Forest", "Lake", "Quarry", "Meadow", "Farm")


@pytest.fixture
def place(platform: Platform) -> Place:
    return phase_of_rows(platform)


def address(place: Place) -> str:
    with place.platform.database.reading() as session:
        phase = session.get_one(Phase, place.phase.id)
        return f"/admin/benchmarks/{session.get_one(Benchmark, phase.benchmark_id).name}/{phase.name}"


def entries_by_both_truths(place: Place) -> None:
    """Five entries with a score by the truth on the board and by another one, which turns their order."""
    truth_id = another_truth(place)
    for name, old, new in zip(TEAMS, BEFORE, AFTER, strict=True):
        submission_id = scored_entry(place, team(place, name), old, method=f"{name}Net")
        scored(place, submission_id, new, truth_id)


def test_a_re_score_is_started_read_as_a_difference_and_activated(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    entries_by_both_truths(place)
    with site.visit(administrator) as page:
        page.goto(address(place))
        page.get_by_role("button", name="Start re-score").click()
        give_reason(page, "labels of the quarry corrected", "Start re-score")
        expect(page.get_by_role("heading", name="labels of the quarry corrected")).to_be_visible()
        expect(page.get_by_text("5 of 5")).to_be_visible()
        expect(page.get_by_role("img", name=re.compile("Ranks before and after"))).to_be_visible()
        expect(page.get_by_role("row", name=re.compile("LakeNet"))).to_contain_text("▲ 1")
        page.get_by_role("button", name="Activate").click()
        expect(page.get_by_role("dialog")).to_contain_text("with a new leader")
        give_reason(page, "as announced", "Activate now")
        expect(page.locator("#rescore")).to_contain_text("activated")
        expect(page.get_by_role("button", name="Abandon")).to_have_count(0)
    with platform.database.reading() as session:
        assert session.query(Activation).filter_by(phase_id=place.phase.id).count() == 2


def test_reported_rows_are_edited_and_put_back_at_once(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    with site.visit(administrator, expected=["422"]) as page:
        page.goto(address(place))
        editor = page.get_by_role("region", name="Reported results")
        for number in range(2):
            editor.get_by_role("button", name="Add a row").click()
            row = editor.get_by_role("row").nth(number + 1)
            row.get_by_label("Method").fill(f"Paper {number}")
            row.get_by_label("Modality").select_option("C+L")
            row.get_by_label("Kind").select_option("ceiling")
            row.get_by_label("Source").fill("authors, year, table 2")
            row.get_by_label("Note").fill("of another split")
            row.get_by_label("miou").fill("0.342")
            row.get_by_label("Decimals (per cent)").fill("1")
        editor.get_by_label("Reason").fill("what the papers report")
        row.get_by_label("Source").fill("a\u200bb")
        editor.get_by_role("button", name="Save").click()
        expect(editor.get_by_role("alert")).to_contain_text("source")
        row.get_by_role("button", name="Remove this row").click()
        editor.get_by_role("button", name="Save").click()
        expect(page.get_by_text("1 reported row saved.")).to_be_visible()
        expect(editor.get_by_role("alert")).to_be_empty()
    with platform.database.reading() as session:
        rows = reported_in(session, place.phase.id)
    assert [(row.method, row.modality, row.miou, row.iou_t) for row in rows] == [("Paper 0", "C+L", 0.342, None)]
    assert [(row.note, row.percent_digits, row.kind) for row in rows] == [("of another split", 1, "ceiling")]


NAMED_FROM_NS = 4_102_444_800_123_456_000  # with microseconds, which no picker knows


@pytest.fixture
def world(platform: Platform) -> World:
    return benchmark_world(platform, frames=1)


def nanoseconds(*moment: int) -> int:
    return int(datetime(*moment, tzinfo=UTC).timestamp()) * 10**9  # type: ignore[misc, arg-type]


def test_dates_are_chosen_in_a_time_zone_and_the_window_in_days(site: Site, world: World) -> None:
    with world.platform.database.transaction() as session:
        session.get_one(Phase, world.val).named_from_ns = NAMED_FROM_NS
    with site.visit(world.administrator, timezone_id="Asia/Seoul") as page:
        page.goto(f"/admin/benchmarks/{world.benchmark}/val")
        page.get_by_role("button", name="Edit rules").click()
        rules = page.get_by_role("dialog")
        zone = rules.get_by_label("Time zone")
        expect(zone).to_have_value("Asia/Seoul")
        expect(rules.get_by_label("Team names shown from")).to_have_value("2100-01-01T09:00")
        rules.get_by_label("Closes").fill("2199-10-01T09:00")
        expect(rules.get_by_text("2199-10-01 00:00 UTC")).to_be_visible()
        zone.select_option("Etc/GMT+12")
        expect(rules.get_by_label("Closes")).to_have_value("2199-09-30T12:00")
        zone.select_option("UTC")
        expect(rules.get_by_label("Closes")).to_have_value("2199-10-01T00:00")
        rules.get_by_label("Opens").fill("2026-01-02T03:04:05")
        rules.get_by_label("Window, days").fill("14")
        rules.get_by_label("Reason").fill("one month more")
        with page.expect_navigation():
            rules.get_by_role("button", name="Save").click()
        page.get_by_role("button", name="Edit rules").click()
        expect(rules.get_by_label("Window, days")).to_have_value("14")
    with world.platform.database.reading() as session:
        phase = session.get_one(Phase, world.val)
        assert phase.closes_ns == nanoseconds(2199, 10, 1)
        assert phase.opens_ns == nanoseconds(2026, 1, 2, 3, 4, 5)
        assert phase.named_from_ns == NAMED_FROM_NS
        assert phase.window_ns == 14 * 86400 * 10**9


def test_a_line_of_the_audit_log_that_somebody_changed_is_found(site: Site, administrator: Person) -> None:
    for name in ("ada", "ben"):
        body = {"name": name, "role": "curator", "reason": "joins"}
        added = httpx.post(f"{site.url}/api/v1/admin/users", json=body, headers=administrator.headers)
        assert added.status_code == 201
    with site.platform.database.transaction() as session:
        unguarded(session)
        session.execute(update(AuditEntry).where(AuditEntry.number == 2).values(reason="nothing to see"))
    with site.visit(administrator) as page:
        page.goto("/admin/audit")
        expect(page.get_by_text("broken at line 2")).to_be_visible()
