"""A sequence's page before there is anything, while the platform is at it, and to those whose it is not."""

import httpx
import pytest
from playwright.sync_api import Route, expect
from sqlalchemy import select

from services.runtime.orm import Job, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person, serving
from testing.web.browsing import PATIENCE_MS, Site
from testing.worlds import made
from tests.web.looking import look
from tests.web.test_pages_access import cookie
from web.main import make_site

OPEN = ("", "/frames", "/track", "/calibration", "/exports")
OWN = ("/recordings", "/processing", "/label-sets")


def new_sequence(platform: Platform, owner: Person, name: str = "forest") -> dict[str, str]:
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner.user_id, name=name)
        session.add(row)
        session.flush()
        return {"id": row.id, "name": row.name, "owner_id": owner.user_id}


def advance(platform: Platform, run_id: str, kind: str, state: str) -> None:
    """As a worker would write it down."""
    with platform.database.transaction() as session:
        for row in session.scalars(select(Job).where(Job.root_id == run_id, Job.kind.in_([kind, "sequence.process"]))):
            row.state = state if row.kind == kind else "running"
            row.revision += 1


def test_a_new_sequence_says_what_is_to_be_done(site: Site, curator: Person) -> None:
    shown = new_sequence(site.platform, curator)
    with site.visit(curator) as page:
        page.goto(f"/sequences/{shown['id']}")
        way = page.get_by_role("list", name="Setup steps")
        assert way.get_by_role("listitem").count() == 3
        expect(page.get_by_role("heading", name="Upload the recording")).to_be_visible()
        expect(page.get_by_role("button", name="Start processing")).to_be_disabled()
        look(page, "sequence-new")
        page.goto(f"/sequences/{shown['id']}/track")
        expect(page.get_by_role("heading", name="No track yet")).to_be_visible()


def test_stages_move_on_without_loading_the_page_again_and_the_run_is_cancelled(site: Site, curator: Person) -> None:
    shown = new_sequence(site.platform, curator)
    run_id = made.run(site.platform, curator, "ingest.synchronise", "labeler.parts", sequence_id=shown["id"])
    with site.visit(curator) as page:
        page.goto(f"/sequences/{shown['id']}/processing")
        synchronising = page.locator(".run-steps li", has_text="Synchronise sensors")
        expect(synchronising).to_have_attribute("data-state", "waiting")
        page.evaluate("window.isSame = true")
        advance(site.platform, run_id, "ingest.synchronise", "running")
        expect(synchronising).to_have_attribute("data-state", "running", timeout=PATIENCE_MS)
        advance(site.platform, run_id, "ingest.synchronise", "succeeded")
        expect(synchronising).to_have_attribute("data-state", "succeeded", timeout=PATIENCE_MS)
        assert page.evaluate("window.isSame")
        look(page, "sequence-running")
        page.get_by_role("button", name="Cancel this run").click()
        page.get_by_label("Reason").fill("the wrong calibration")
        page.get_by_role("dialog").get_by_role("button", name="Cancel this run").click()
        expect(page.locator("#runs .state").first).to_have_text("cancelled", timeout=PATIENCE_MS)


def test_the_log_and_the_buttons_are_of_a_run_that_starts_while_the_page_is_open(site: Site, curator: Person) -> None:
    shown = new_sequence(site.platform, curator)
    before = made.run(site.platform, curator, "ingest.synchronise", sequence_id=shown["id"])
    advance(site.platform, before, "ingest.synchronise", "failed")
    with site.platform.database.transaction() as session:
        session.get_one(Job, before).state = "failed"
    with site.visit(curator) as page:
        page.goto(f"/sequences/{shown['id']}/processing")
        expect(page.locator("#run-log")).to_have_attribute("data-log", f"/api/v1/jobs/{before}/logs")
        expect(page.get_by_role("button", name="Cancel this run")).to_have_count(0)
        now = made.run(site.platform, curator, "ingest.synchronise", sequence_id=shown["id"])
        expect(page.locator("#run-log")).to_have_attribute("data-log", f"/api/v1/jobs/{now}/logs", timeout=PATIENCE_MS)
        expect(page.get_by_role("button", name="Cancel this run")).to_be_visible()


def test_a_page_follows_on_after_a_platform_that_was_busy_when_it_asked(site: Site, curator: Person) -> None:
    """A browser gives a stream up for good when the answer to it is none; the page would stand still without a word."""
    shown = new_sequence(site.platform, curator)
    run_id = made.run(site.platform, curator, "ingest.synchronise", sequence_id=shown["id"])
    refused: list[str] = []

    def refuse_once(route: Route) -> None:
        refused.append(route.request.url)
        if len(refused) == 1:
            route.fulfill(status=503, content_type="application/problem+json", body="{}")
        else:
            route.continue_()

    with site.visit(curator, expected=["503"]) as page:
        page.route("**/events", refuse_once)
        page.goto(f"/sequences/{shown['id']}/processing")
        advance(site.platform, run_id, "ingest.synchronise", "running")
        stage = page.locator(".run-steps li", has_text="Synchronise sensors")
        expect(stage).to_have_attribute("data-state", "running", timeout=PATIENCE_MS)
    assert len(refused) == 2


def test_new_labels_are_shown_as_soon_as_they_count(site: Site, curator: Person) -> None:
    shown = new_sequence(site.platform, curator)
    run_id = made.run(site.platform, curator, "ingest.synchronise", sequence_id=shown["id"])
    with site.visit(curator) as page:
        page.goto(f"/sequences/{shown['id']}")
        expect(page.locator(".run-dashes")).to_be_visible()
        made.labels(site.platform, shown, contents=[made.frame_labels()] * 3)
        advance(site.platform, run_id, "ingest.synchronise", "succeeded")
        expect(page.get_by_role("heading", name="Summary")).to_be_visible(timeout=PATIENCE_MS)


@pytest.mark.parametrize(("is_public", "seen"), [(False, 404), (True, 200)])
def test_others_see_what_is_public_of_it_and_never_what_is_only_its_owners(
    platform: Platform, curator: Person, participant: Person, is_public: bool, seen: int
) -> None:
    shown = new_sequence(platform, curator)
    made.labels(platform, shown, contents=[made.frame_labels()] * 3)
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, shown["id"]).is_public = is_public
    visitor, other, own = dict[str, str](), cookie(platform, participant), cookie(platform, curator)
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url, timeout=300) as client:

        def status(section: str, who: dict[str, str]) -> int:
            path = f"/sequences/{shown['id']}{section}"
            return client.get(path, headers={"Accept": "text/html", **who}).status_code

        assert {status(section, other) for section in OPEN} == {seen}
        assert {status(section, visitor) for section in OPEN} == {200 if is_public else 401}
        assert {status(section, other) for section in OWN} == {404}
        assert {status(section, visitor) for section in OWN} == {401}
        assert {status(section, own) for section in OPEN + OWN} == {200}
