"""A session that ends while its page is open: the reader signs in on the page, and nothing that was entered is lost."""

from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, Page, expect
from sqlalchemy import delete, select

from api.middleware.context import COOKIE
from services.ingest.queue_handlers import handlers
from services.runtime.access import passwords, sessions, users
from services.runtime.orm import SubmissionRow, User, WebSession
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.web.browsing import Site
from testing.worlds.benchmark_world import benchmark_world, predicted, run_eval, submission_zip
from tests.web.bringing import BULKY, bag, choose, recordings, row_of, slow_down, uploads
from tests.web.looking import serious_findings
from tests.web.test_upload_broken_off import ENOUGH, SLOW, hold_at, pieces_taken
from tests.working import working

PASSWORD = "correct horse battery staple"
ENDED = ["401"]


@pytest.fixture(scope="module")
def hashed() -> str:
    return passwords.hash_password(PASSWORD)


def give_password(platform: Platform, who: Person, hashed: str) -> None:
    with platform.database.transaction() as session:
        users.change_password(session, session.get_one(User, who.user_id), hashed)


def end_sessions(platform: Platform) -> None:
    with platform.database.transaction() as session:
        session.execute(delete(WebSession))


def sign_in_elsewhere(site: Site, browser: BrowserContext, who: Person) -> None:
    """In another tab of the same browser; the sessions before it end.

    They end once the cookie is the new one: what the page still loads by itself is never refused in between, which
    would ask the reader to sign in.
    """
    with site.platform.database.transaction() as session:
        former = session.scalars(select(WebSession.id)).all()
        secret = sessions.open_session(session, session.get_one(User, who.user_id), 3600.0).secret
    browser.add_cookies([{"name": COOKIE, "value": secret, "url": site.url}])
    with site.platform.database.transaction() as session:
        session.execute(delete(WebSession).where(WebSession.id.in_(former)))


def sign_in(page: Page, password: str = PASSWORD) -> None:
    asking = page.get_by_role("dialog", name="Your session has ended")
    asking.get_by_label("Password").fill(password)
    asking.get_by_role("button", name="Sign in").click()


def test_a_session_that_ends_while_a_form_is_filled_in_costs_one_password(
    site: Site, platform: Platform, tmp_path: Path, hashed: str
) -> None:
    world = benchmark_world(platform, frames=1)
    captain = world.captains[0]
    archive = submission_zip(tmp_path / "run.zip", predicted(world.truth("val"), 0.1))
    with site.visit(captain, expected=ENDED) as page:
        page.goto(f"/benchmarks/{world.benchmark}/val/submit", wait_until="networkidle")
        page.locator("#file").set_input_files(archive)
        page.get_by_label("Method name").fill("OccFormer-T")
        page.get_by_label("LiDAR").check()
        page.get_by_label("Description").fill("Two cameras fewer.")
        give_password(platform, captain, hashed)
        end_sessions(platform)
        page.get_by_role("button", name="Submit for scoring").click()
        asking = page.get_by_role("dialog", name="Your session has ended")
        expect(asking.get_by_label("Name")).to_have_value(captain.name)
        expect(asking.get_by_label("Password")).to_be_focused()
        assert serious_findings(page) == []
        sign_in(page, "a wrong one")
        expect(asking.get_by_role("alert")).to_contain_text("password")
        asking.get_by_role("button", name="Cancel").click()
        expect(page.locator("#said")).to_contain_text("or sign in")
        expect(page.get_by_label("Method name")).to_have_value("OccFormer-T")
        page.get_by_role("button", name="Submit for scoring").click()
        sign_in(page)
        expect(page.get_by_text("Next in the queue")).to_be_visible()
        run_eval(platform)
        expect(page.get_by_text("Scored, and on the leaderboard.")).to_be_visible()
    with platform.database.reading() as session:
        [row] = session.scalars(select(SubmissionRow)).all()
    assert (row.state, row.method, row.description) == ("scored", "OccFormer-T", "Two cameras fewer.")


def test_an_upload_goes_on_where_its_session_ended(site: Site, curator: Person, hashed: str) -> None:
    path = bag(BULKY, "long-run")
    with site.visit(curator, expected=ENDED) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        choose(page, path)
        slow_down(page, SLOW)
        page.get_by_role("button", name="Upload").click()
        hold_at(page, site.platform, ENOUGH)
        give_password(site.platform, curator, hashed)
        end_sessions(site.platform)
        slow_down(page, -1)
        row = row_of(page, "long-run.mcap")
        expect(row.locator("[data-phase]")).to_have_text("waiting for sign-in")
        taken = pieces_taken(page)
        sign_in(page)
        expect(row.locator("[data-phase]")).to_have_text("registered")
    assert taken[0] >= ENOUGH
    assert len(uploads(site.platform)) == len(recordings(site.platform)) == 1


def test_signing_in_again_in_another_tab_is_enough(site: Site, curator: Person) -> None:
    with site.visit(curator, expected=["403"]) as page:
        page.goto("/sequences/new")
        token = page.locator('meta[name="csrf-token"]').get_attribute("content")
        sign_in_elsewhere(site, page.context, curator)
        choose(page, bag())
        page.get_by_role("button", name="Upload").click()
        expect(row_of(page, "run.mcap").locator("[data-phase]")).to_have_text("reading")
        assert page.locator('meta[name="csrf-token"]').get_attribute("content") != token


def test_what_somebody_entered_is_never_sent_as_somebody_else(site: Site, curator: Person) -> None:
    other = person(site.platform, "curator")
    with site.visit(curator, expected=["403"]) as page:
        page.goto("/account")
        page.get_by_role("button", name="New token").click()
        page.get_by_role("dialog").get_by_label("Name").fill("training cluster")
        sign_in_elsewhere(site, page.context, other)
        with page.expect_navigation():
            page.get_by_role("dialog").get_by_role("button", name="Create").click()
        expect(page.get_by_role("heading", name=other.name)).to_be_visible()
        expect(page.get_by_text("training cluster")).to_have_count(0)
