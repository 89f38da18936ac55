"""What a page says of a run that did not succeed: on every part of a sequence, to whom it concerns, without reload."""

import httpx
import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import select

from services.runtime.orm import Job, JobAttempt, JobLine, SequenceRow, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import PATIENCE_MS, Site
from testing.worlds import made
from tests.web.looking import look
from tests.web.sequence_world import whole_sequence

PARTS = ("", "/frames", "/track", "/recordings", "/calibration", "/processing", "/label-sets", "/exports")
TROUBLE = "The last run failed"
STAGES = ("ingest.synchronise", "labeler.fuse", "labeler.surface")


def fail_at_the_surface(platform: Platform, run_id: str) -> None:
    """As workers would write it down: the first stage is done, the second stopped, the third failed with a line."""
    at_ns = now_ns()
    states = {"ingest.synchronise": "succeeded", "labeler.fuse": "cancelled", "labeler.surface": "failed"}
    with platform.database.transaction() as session:
        for row in session.scalars(select(Job).where(Job.root_id == run_id)):
            row.state = states.get(row.kind, "failed")
            row.started_ns, row.finished_ns, row.revision = at_ns - 9 * 10**9, at_ns, row.revision + 1
            if row.state == "failed":
                row.failure_code, row.failure = "surface_empty", "no point survived carving"
            if row.kind == "labeler.surface":
                session.add(JobAttempt(job_id=row.id, number=1, worker="w:1", outcome="failed", started_ns=at_ns))
                session.flush()
                line = JobLine(job_id=row.id, attempt=1, number=0, level="error", event="the tile has no surface")
                session.add(line)


def standing(page: Page) -> str:
    return page.locator("#standing").inner_text()


def test_a_failed_rerun_is_said_on_every_part_with_its_log_and_never_to_visitors(site: Site, curator: Person) -> None:
    shown = whole_sequence(site.platform, curator)
    base = f"/sequences/{shown['id']}"
    with site.platform.database.transaction() as session:
        session.get_one(SequenceRow, shown["id"]).is_public = True
    run_id = made.run(site.platform, curator, *STAGES, sequence_id=shown["id"])
    with site.visit(curator) as page:
        page.goto(f"{base}/track")
        expect(page.locator("#word")).to_have_text("queued")
        page.evaluate("window.isSame = true")
        fail_at_the_surface(site.platform, run_id)
        expect(page.locator("#word")).to_contain_text("re-run failed", timeout=PATIENCE_MS)
        expect(page.get_by_role("region", name=TROUBLE)).to_contain_text("no point survived carving")
        assert page.evaluate("window.isSame"), "the page was loaded again"
        for part in PARTS:
            page.goto(base + part)
            assert "surface_empty" in standing(page), part
            expect(page.locator("#word")).to_contain_text("labelled")
        page.goto(base)
        look(page, "sequence-rerun-failed")
        page.get_by_role("link", name="Log and stages").click()
        states = {row.get_attribute("data-state") for row in page.locator(".run-steps li").all()}
        assert states == {"succeeded", "cancelled", "failed"}, "a stage of an ended run is shown as running"
        expect(page.get_by_role("log", name="Lines of the log")).to_contain_text("the tile has no surface")
        look(page, "sequence-processing-log")
        page.goto("/sequences")
        expect(page.locator(".sequence-card")).to_contain_text("re-run failed")
    with site.visit() as page:
        for path in (base, "/sequences"):
            page.goto(path)
            expect(page.get_by_text("re-run failed")).to_have_count(0)
            expect(page.get_by_text("surface_empty")).to_have_count(0)


def test_an_owner_reads_why_an_administrator_cancelled(site: Site, curator: Person, administrator: Person) -> None:
    shown = whole_sequence(site.platform, curator)
    base = f"/sequences/{shown['id']}"
    run_id = made.run(site.platform, curator, *STAGES, sequence_id=shown["id"])
    with site.visit(administrator) as page:
        page.goto(f"/admin/jobs/{run_id}")
        expect(page.get_by_role("heading", name="Labelling")).to_be_visible()
        look(page, "admin-run")
        page.get_by_role("button", name="Cancel").first.click()
        page.get_by_role("dialog").get_by_label("Reason").fill("disk maintenance at noon")
        page.get_by_role("dialog").get_by_role("button", name="Cancel", exact=True).last.click()
        expect(page.locator("#job .state").first).to_have_text("cancelled", timeout=PATIENCE_MS)
    with site.visit(curator) as page:
        for part in ("", "/processing"):
            page.goto(base + part)
            expect(page.locator("#standing")).to_contain_text("was cancelled by an administrator")
            expect(page.locator("#standing")).to_contain_text("disk maintenance at noon")
        expect(page.locator("#runs")).to_contain_text("By an administrator: disk maintenance at noon")


def test_processing_is_never_to_do_while_it_runs(site: Site, curator: Person) -> None:
    with site.platform.database.transaction() as session:
        row = SequenceRow(owner_id=curator.user_id, name="forest")
        session.add(row)
        session.flush()
        sequence_id = row.id
    run_id = made.run(site.platform, curator, *STAGES, sequence_id=sequence_id)
    with site.visit(curator) as page:
        page.goto(f"/sequences/{sequence_id}")
        step = page.get_by_role("list", name="Setup steps").get_by_role("listitem").nth(2)
        expect(step).to_have_attribute("data-state", "running")
        expect(step).to_contain_text("running")
        expect(page.get_by_role("button", name="Start processing")).to_be_disabled()
        fail_at_the_surface(site.platform, run_id)
        expect(step).to_have_attribute("data-state", "failed", timeout=PATIENCE_MS)
        expect(page.get_by_role("region", name=TROUBLE)).to_be_visible()


@pytest.mark.parametrize("kind", ["labeler.export", "eval.compare"])
def test_what_is_made_of_labels_is_no_state_of_the_sequence(site: Site, curator: Person, kind: str) -> None:
    shown = whole_sequence(site.platform, curator)
    with site.platform.database.transaction() as session:
        for _ in range(14):  # more than the page lists
            job = Job(owner_id=curator.user_id, sequence_id=shown["id"], kind=kind, queue=kind.partition(".")[0])
            job.id = job.root_id = new_id()
            job.state = "failed"
            session.add(job)
        job = Job(owner_id=curator.user_id, sequence_id=shown["id"], kind=kind, queue=kind.partition(".")[0])
        job.id = job.root_id = new_id()
        session.add(job)
    with httpx.Client(base_url=site.url, headers=curator.headers) as api:
        listed = api.get(f"/api/v1/sequences/{shown['id']}").json()
    assert listed["job"]["kind"] == "sequence.process"
    with site.visit(curator) as page:
        page.goto(f"/sequences/{shown['id']}/processing")
        expect(page.locator("#word")).to_have_text("labelled")
        expect(page.locator("#process-start")).not_to_contain_text("current run")
        expect(page.get_by_role("button", name="Cancel this run")).to_have_count(0)
        assert "queued" in standing(page)
