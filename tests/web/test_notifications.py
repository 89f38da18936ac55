"""Notifications on the account's page in a browser: chosen, sent somewhere, seen delivered."""

import re

from playwright.sync_api import expect

from services.domain.notifications.email_addresses import new_secret
from services.runtime.orm import EmailAddress, NotificationChoice, NotificationDelivery, NotificationEvent, Webhook
from services.runtime.orm.base import now_ns
from testing.api.serving import Person
from testing.web.browsing import Site
from tests.web.looking import look


def test_events_are_chosen_and_a_webhook_is_set_whose_secret_is_shown_once(site: Site, participant: Person) -> None:
    with site.visit(participant) as page:
        page.goto("/account#notifications")
        page.get_by_label("One of my runs failed: by webhook").check()
        page.locator("#choices").get_by_role("button", name="Save").click()
        expect(page.get_by_text("Saved.")).to_be_visible()
        page.get_by_label(re.compile("^URL")).fill("https://chat.example.org/hooks/abc")
        page.locator("#webhook").get_by_role("button", name="Save").click()
        expect(page.locator("[data-secret]")).to_have_text(re.compile("^whsec_"))
        expect(page.get_by_role("heading", name="Your webhook's secret")).to_be_visible()
        expect(page.locator("#webhook code")).to_have_text("https://chat.example.org/hooks/abc")
    with site.platform.database.reading() as session:
        chosen = session.query(NotificationChoice).all()
    assert [(row.user_id, row.kind, row.channel) for row in chosen] == [(participant.user_id, "run.failed", "webhook")]


def test_last_deliveries_are_seen_with_what_came_of_them(site: Site, participant: Person) -> None:
    with site.platform.database.transaction() as session:
        for state, answer in (("delivered", "answered 200"), ("waiting", "answered 503"), ("dead", "x" * 300)):
            event = NotificationEvent(kind="run.failed", key=state, user_id=participant.user_id)
            session.add(event)
            session.flush()
            row = NotificationDelivery(event_id=event.id, user_id=participant.user_id, channel="webhook")
            row.state, row.answer, row.tries, row.due_ns = state, answer, 1, now_ns()
            session.add(row)
        session.add(EmailAddress(user_id=participant.user_id, address="ada@example.org", verified_ns=now_ns()))
        failing = Webhook(user_id=participant.user_id, url=f"https://chat.example.org/hooks/{'x' * 60}", secret="")
        failing.failing_ns = now_ns()
        session.add(failing)
    with site.visit(participant) as page:
        page.goto("/account")
        expect(page.locator("#deliveries li")).to_have_count(3)
        look(page, "account-notifications")


def test_the_mailed_link_leads_to_a_button_that_verifies_the_address(site: Site, participant: Person) -> None:
    with site.platform.database.transaction() as session:
        row = EmailAddress(user_id=participant.user_id, address="ada@example.org")
        session.add(row)
        session.flush()
        secret = new_secret(session, row)
    with site.visit(participant) as page:
        page.goto(f"/account?email_secret={secret}#notifications")
        expect(page.locator("#email").get_by_text("not verified")).to_be_visible()
        look(page, "account-verification")
        page.get_by_role("button", name="Confirm address").click()
        expect(page.locator("#email").get_by_text("verified", exact=True)).to_be_visible()
        expect(page.get_by_role("button", name="Confirm address")).to_have_count(0)


def test_a_private_address_is_refused_where_it_is_typed(site: Site, participant: Person) -> None:
    with site.visit(participant, expected=["422"]) as page:
        page.goto("/account")
        page.get_by_label(re.compile("^URL")).fill("https://127.0.0.1/hooks/abc")
        page.locator("#webhook").get_by_role("button", name="Save").click()
        expect(page.locator("#webhook .said")).to_contain_text("may not be sent to")
