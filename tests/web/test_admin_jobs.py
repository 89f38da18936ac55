"""The administrator at the jobs: looks, finds, selects many, acts with a reason, reads on."""

import re

import pytest
from playwright.sync_api import Page, expect

from benchmarks.dashboard.rows import fill
from services.runtime.jobs.execution import run_next
from services.runtime.orm import AuditEntry, Job, JobLine
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import job, row_of, run
from tests.api.test_jobs import HANDLERS, run_all
from tests.web.looking import look


@pytest.fixture
def busy(platform: Platform) -> str:
    """A platform with work of all kinds; the id of a run that runs."""
    with platform.database.transaction() as session:
        return fill(session, runs=120, workers=20).running_id


def reason(page: Page, words: str) -> None:
    page.get_by_role("dialog").get_by_label("Reason").fill(words)


def test_the_work_is_seen_at_a_glance_and_found_by_state(site: Site, administrator: Person, busy: str) -> None:
    with site.visit(administrator) as page:
        page.goto("/admin/jobs")
        expect(page.get_by_role("link", name="Jobs", exact=True)).to_have_attribute("aria-current", "page")
        expect(page.get_by_role("list", name="Worker processes").get_by_role("listitem")).to_have_count(20)
        look(page, "admin-jobs")
        page.get_by_role("link", name="Dead letters").click()
        expect(page.get_by_role("row").nth(1)).to_contain_text("worker_lost")
        page.get_by_label("Owner").fill("grace")
        page.get_by_role("button", name="Filter").click()
        expect(page).to_have_url(re.compile("list=dead.*owner=grace"))
        page.get_by_label("Owner").fill("nobody")
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="No matching jobs")).to_be_visible()
        page.goto("/admin/queues")
        expect(page.get_by_text("worker-2:4719")).to_be_visible()
        look(page, "admin-queues")
        page.goto(f"/admin/jobs/{busy}")
        expect(page.get_by_role("img", name=re.compile("Reconstruct the surface: 1 running"))).to_be_visible()
        look(page, "admin-run")


def test_the_count_of_failed_jobs_is_red_only_where_there_are_some(
    site: Site, platform: Platform, administrator: Person, curator: Person
) -> None:
    colour = "one => getComputedStyle(one).backgroundColor"
    with site.visit(administrator) as page:
        page.goto("/admin/jobs")
        counts = {word: page.locator(f".count[data-list={word}]") for word in ("queued", "failed", "dead")}
        assert len({one.evaluate(colour) for one in counts.values()}) == 1
        job(platform, curator, "ingest.refuse")
        run_all(platform)
        page.goto("/admin/jobs")
        expect(counts["failed"]).to_have_text("1")
        assert counts["failed"].evaluate(colour) != counts["queued"].evaluate(colour)


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
        reason(page, "the disk was full")
        page.get_by_role("dialog").get_by_role("button", name="Retry").click()
        expect(page.get_by_role("dialog")).to_contain_text("3 queued again, 1 refused")
        expect(page.get_by_role("dialog")).to_contain_text("ingest.speak")
        look(page, "admin-jobs-acted")
        page.keyboard.press("Escape")
        expect(page.locator("[data-picked-count]")).to_have_text("1")
        page.keyboard.press("Escape")
        expect(page.locator("[data-picked]")).to_be_hidden()
    assert [row_of(platform, one).state for one in failed] == ["queued"] * 3
    assert row_of(platform, fine).state == "succeeded"


def test_a_queue_is_paused_and_resumed_with_a_reason(site: Site, platform: Platform, administrator: Person) -> None:
    with site.visit(administrator) as page:
        page.goto("/admin/queues")
        labeler = page.get_by_role("region", name="labeler")
        labeler.get_by_role("button", name="Pause").click()
        reason(page, "worker-3 is being replaced")
        page.keyboard.press("Enter")
        expect(labeler.locator(".state")).to_have_text("paused")
        labeler.get_by_role("button", name="Resume").click()
        reason(page, "it is back")
        page.keyboard.press("Enter")
        expect(labeler.locator(".state")).to_have_text("open")
    with platform.database.reading() as session:
        acts = [line.act for line in session.query(AuditEntry).all()]
    assert acts[-2:] == ["queue.pause", "queue.resume"]


def test_a_run_is_looked_at_cancelled_and_queued_again(
    site: Site, platform: Platform, administrator: Person, curator: Person
) -> None:
    root_id = run(platform, curator, "ingest.speak", "labeler.speak", "labeler.speak")
    assert run_next(platform, "ingest", HANDLERS)
    with site.visit(administrator) as page:
        page.goto(f"/admin/jobs/{root_id}")
        expect(page.get_by_text("1 of 3", exact=True)).to_be_visible()
        page.get_by_role("button", name="Cancel").click()
        reason(page, "wrong calibration")
        page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
        expect(page.locator("#job")).to_have_attribute("data-state", "cancelled")
        expect(page.get_by_text("wrong calibration").first).to_be_visible()
        page.get_by_role("button", name="Retry").click()
        reason(page, "the right one is there")
        page.get_by_role("dialog").get_by_role("button", name="Retry").click()
        expect(page.locator("#job")).to_have_attribute("data-state", "queued")
        while run_next(platform, "labeler", HANDLERS):
            pass
        expect(page.locator("#job")).to_have_attribute("data-state", "succeeded")


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
        look(page, "admin-job")


def say(platform: Platform, job_id: str, first: int, end: int) -> None:
    """Lines of an attempt before the first, as a worker writes them; every fiftieth is an error."""
    with platform.database.transaction() as session:
        for number in range(first, end):
            level = "error" if number % 50 == 0 and number < 200 else "info"
            line = JobLine(job_id=job_id, attempt=0, number=number, level=level, event=f"line {number}")
            line.facts, line.logged_ns = {"tile": f"{number}_0"}, now_ns()
            session.add(line)


def test_somebody_elses_job_and_no_job_are_pages_that_say_so(site: Site, administrator: Person) -> None:
    with site.visit(administrator, expected=["404"]) as page:
        answer = page.goto(f"/admin/jobs/{'0' * 32}")
        assert answer is not None
        assert answer.status == 404
    with site.platform.database.reading() as session:
        assert session.query(Job).count() == 0
