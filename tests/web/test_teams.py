"""A team from its founding to being handed over, at its pages; and what a participant does not meet."""

import re

import pytest
from playwright.sync_api import expect

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.teams.teams import enter
from services.runtime.orm import Phase
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.web.browsing import Site
from testing.worlds.benchmark_world import World, benchmark_world
from tests.services.domain.benchmarks import laid
from tests.web.looking import look


@pytest.fixture
def world(platform: Platform) -> World:
    return benchmark_world(platform)


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


def test_a_team_is_founded_entered_by_invitation_and_handed_over(site: Site, participant: Person) -> None:
    guest = person(site.platform, "participant")
    with site.visit(participant) as page:
        page.goto("/teams")
        look(page, "teams-empty")
        page.get_by_label("Name").fill("Terrain Gang")
        page.get_by_role("button", name="Create team").click()
        expect(page.get_by_role("heading", name="Terrain Gang")).to_be_visible()
        where = page.url
        page.get_by_role("button", name="Create invitation").click()
        expect(page.get_by_label("Invitation", exact=True)).to_have_value(re.compile("invite_"))
        secret = page.get_by_label("Invitation", exact=True).input_value()
        expect(page.locator("#invitations li")).to_have_count(1)
        expect(page.locator("#invitations")).to_contain_text("valid until")
        look(page, "team-inviting")
    assert re.fullmatch(r"invite_[A-Za-z0-9_-]{43}", secret)
    with site.visit(guest, expected=["404"]) as page:
        answer = page.goto(where)
        assert answer is not None
        assert answer.status == 404, "a team of others has no page"
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
        expect(page.get_by_role("heading", name="No team yet")).to_be_visible()


def test_a_team_sees_what_it_may_still_have_scored(site: Site, world: World) -> None:
    limited(world, "test", 3)
    with site.platform.database.transaction() as session:
        phase = session.get_one(Phase, world.test)
        scoring_quota.grant(session, phase, world.teams[0], 1, "a day was lost")
    with site.visit(world.captains[0]) as page:
        page.goto(f"/teams/{world.teams[0]}")
        expect(page.get_by_text("2 of 4 submissions left within 7 d")).to_be_visible()
        expect(page.get_by_role("img", name="1 used, 1 in progress, 2 left")).to_be_visible()
        look(page, "team")
        page.goto("/teams")
        look(page, "teams")


def test_who_has_no_team_is_asked_for_one_where_they_would_submit(
    site: Site, world: World, participant: Person
) -> None:
    with site.visit(participant) as page:
        page.goto(f"/benchmarks/{world.benchmark}/val/submit")
        look(page, "submit-without-team")
        page.get_by_label("Team name").fill("Lone Wolf")
        page.get_by_role("button", name="Create team").click()
        expect(page.get_by_text("Choose a zip first.")).to_be_visible()


def test_a_closed_phase_says_so_instead_of_a_form(site: Site, world: World) -> None:
    with site.platform.database.transaction() as session:
        phase = session.get_one(Phase, world.test)
        phase.opens_ns, phase.closes_ns = 1, 2
    with site.visit(world.captains[0]) as page:
        page.goto(f"/benchmarks/{world.benchmark}/test/submit")
        expect(page.get_by_role("heading", name="This phase is closed")).to_be_visible()
        expect(page.locator("form#submit")).to_have_count(0)
        look(page, "submit-closed")


def test_a_visitor_is_asked_to_sign_in_before_they_submit(site: Site, world: World) -> None:
    with site.visit(expected=["401"]) as page:
        page.goto(f"/benchmarks/{world.benchmark}/val/submit")
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


def test_a_participant_meets_no_page_of_the_administration(site: Site, participant: Person) -> None:
    pages = ("/admin/jobs", "/admin/queues", "/admin/users", "/admin/audit")
    with site.visit(participant, expected=["403"]) as page:
        page.goto("/submissions")
        expect(page.get_by_role("link", name="Administration")).to_have_count(0)
        assert page.locator("a[href^='/admin']").count() == 0
        for path in pages:
            answer = page.goto(path)
            assert answer is not None
            assert answer.status == 403, path
            expect(page.get_by_text("Ask an administrator for the role")).to_be_visible()


def test_an_administrator_steers_a_team_of_others_and_says_why(site: Site, world: World) -> None:
    with site.visit(world.administrator) as page:
        page.goto(f"/teams/{world.teams[0]}")
        page.get_by_role("button", name="Remove").click()
        dialog = page.locator("dialog[open]")
        dialog.get_by_label("Reason").fill("left the institute & the lab")
        dialog.get_by_role("button", name="Remove").click()
        expect(page.locator(".members .member-name").filter(has_text=world.member.name)).to_have_count(0)
