"""People at their pages: signing in, here or with a provider; tokens, passwords, notifications, users, programs."""

import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from services.domain.notifications.email_addresses import new_secret
from services.runtime.access import passwords, sessions, users
from services.runtime.orm import EmailAddress, NotificationChoice, User
from services.runtime.platform import Platform
from testing.api.lab import Lab, served_lab
from testing.api.serving import Person
from testing.servers.oidc import OidcServer, lab_groups
from testing.web.browsing import Site
from web.main import make_site

PASSWORD = "correct horse battery staple"


def with_password(platform: Platform, who: Person) -> None:
    hashed = passwords.hash_password(PASSWORD)
    with platform.database.transaction() as session:
        users.change_password(session, session.get_one(User, who.user_id), hashed)


def test_an_account_has_tokens_events_a_webhook_an_address_and_a_password(site: Site, participant: Person) -> None:
    """One page: what is shown once, what is confirmed, and who is signed out by what."""
    with_password(site.platform, participant)
    with site.platform.database.transaction() as session:
        other = sessions.open_session(session, session.get_one(User, participant.user_id), 3600.0)
        address = EmailAddress(user_id=participant.user_id, address="ada@example.org")
        session.add(address)
        session.flush()
        mailed = new_secret(session, address)
    with site.visit(participant, expected=["422"]) as page:
        page.goto(f"/account?email_secret={mailed}#notifications")
        verify_the_address(page)
        choose_events_and_webhook(page)
        make_and_revoke_a_token(page, site)
        page.get_by_role("button", name="Sign out other browsers").click()
        expect(page.locator("#browsers li")).to_have_count(1)
        cookie = {"Cookie": f"stone_session={other.secret}"}
        assert httpx.get(f"{site.url}/api/v1/me", headers=cookie).status_code == 401
        page.get_by_label("Current password").fill(PASSWORD)
        page.get_by_label(re.compile("^New password")).fill("another horse, another battery")
        page.get_by_label("Repeat the new password").fill("another horse, another battery")
        page.get_by_role("button", name="Change password").click()
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    with site.platform.database.reading() as session:
        chosen = session.query(NotificationChoice).all()
    assert [(row.user_id, row.kind, row.channel) for row in chosen] == [(participant.user_id, "run.failed", "webhook")]


def verify_the_address(page: Page) -> None:
    """The mailed link leads to a button that does."""
    expect(page.locator("#email").get_by_text("not verified")).to_be_visible()
    page.get_by_role("button", name="Confirm address").click()
    expect(page.locator("#email").get_by_text("verified", exact=True)).to_be_visible()
    expect(page.get_by_role("button", name="Confirm address")).to_have_count(0)


def choose_events_and_webhook(page: Page) -> None:
    page.get_by_label("One of my runs failed: by webhook").check()
    page.locator("#choices").get_by_role("button", name="Save").click()
    expect(page.locator("#toasts")).not_to_be_empty()
    url = page.get_by_label(re.compile("^URL"))
    url.fill("https://127.0.0.1/hooks/abc")
    page.locator("#webhook").get_by_role("button", name="Save").click()
    expect(page.locator("#webhook .said")).not_to_be_empty()
    url.fill("https://chat.example.org/hooks/abc")
    page.locator("#webhook").get_by_role("button", name="Save").click()
    expect(page.locator("[data-secret]")).to_have_text(re.compile("^whsec_"))
    expect(page.locator("#webhook code")).to_have_text("https://chat.example.org/hooks/abc")


def make_and_revoke_a_token(page: Page, site: Site) -> None:
    """It is shown once, and works until then."""
    page.goto("/account")
    page.get_by_role("button", name="New token…").click()
    page.get_by_role("dialog").get_by_label("Name").fill("training cluster")
    page.get_by_role("dialog").get_by_role("button", name="Create").click()
    secret = page.locator("[data-secret]")
    expect(secret).to_have_text(re.compile("^stone_"))
    headers = {"Authorization": f"Bearer {secret.inner_text()}"}
    me = httpx.get(f"{site.url}/api/v1/me", headers=headers)
    assert (me.status_code, me.json()["scopes"]) == (200, ["read"])
    expect(page.get_by_role("heading", name="training cluster", exact=True)).to_be_visible()
    page.get_by_role("button", name="Done").click()
    expect(secret).to_be_hidden()
    page.get_by_role("button", name="Revoke training cluster…").click()
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    expect(page.get_by_role("heading", name="training cluster", exact=True)).to_have_count(0)
    assert httpx.get(f"{site.url}/api/v1/me", headers=headers).status_code == 401


def test_a_user_is_added_with_a_password_that_is_shown_once(site: Site, administrator: Person) -> None:
    with site.visit(administrator) as page:
        page.goto("/admin/users")
        page.get_by_role("button", name="Add a user…").click()
        page.get_by_label(re.compile("^Name lowercase")).fill("ada")
        page.get_by_role("radio", name="curator").check()
        page.get_by_role("button", name="Generate").click()
        page.get_by_label("Reason").fill("joins the field team")
        page.get_by_role("button", name="Add", exact=True).click()
        secret = page.locator("[data-secret]")
        expect(secret).to_have_text(re.compile("^[a-z2-9]{4}(-[a-z2-9]{4}){4}$"))
        body = {"name": "ada", "password": secret.inner_text()}
        assert httpx.post(f"{site.url}/api/v1/sessions", json=body).json()["role"] == "curator"
        expect(page.get_by_role("link", name="ada", exact=True)).to_be_visible()
        page.get_by_label("Name contains").fill("nobody")
        page.get_by_role("button", name="Filter", exact=True).click()
        expect(page.get_by_role("heading", name="No matching users")).to_be_visible()


def test_somebody_signs_in_comes_back_to_where_they_were_and_signs_out(site: Site, participant: Person) -> None:
    with_password(site.platform, participant)
    with site.visit(expected=["401"]) as page:
        page.goto("/account")
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        page.get_by_label("Name").fill(participant.name)
        page.get_by_label("Password").fill("a wrong one")
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_role("alert")).to_contain_text("password")
        page.get_by_label("Password").fill(PASSWORD)
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name=participant.name)).to_be_visible()
        page.get_by_role("button", name="Sign out").click()
        expect(page.get_by_role("banner").get_by_role("link", name="Sign in")).to_be_visible()


ELSEWHERE = ["asked another host: http://127.0.0.1", "cdn.jsdelivr.net", "favicon.ico"]
"""The provider's own page, to which the browser goes, and what that asks for."""


@pytest.fixture
def lab(platform: Platform, oidc_server: OidcServer) -> Iterator[Lab]:
    with served_lab(platform, oidc_server.settings(**lab_groups()), make_site) as made:
        yield made


@pytest.fixture
def lab_site(lab: Lab, browser: Browser) -> Site:
    return Site(lab.url, lab.platform, browser)


def sign_in_at_the_provider(page: Page, subject: str) -> None:
    """From our sign-in page to the provider's form and back."""
    page.get_by_role("link", name="Sign in with Field Robotics Lab").click()
    page.get_by_placeholder("sub").fill(subject)
    page.get_by_role("button", name="Authorize").click()


def test_somebody_signs_in_with_the_provider_takes_an_ended_session_up_in_another_tab_and_signs_out(
    lab_site: Site, oidc_server: OidcServer
) -> None:
    oidc_server.know("s-ada", preferred_username="Ada", groups=["field-team"])
    with lab_site.visit(expected=["401", *ELSEWHERE]) as page:
        page.goto("/account")
        expect(page.get_by_role("heading", name="Sign in", exact=True)).to_be_visible()
        sign_in_at_the_provider(page, "s-ada")
        expect(page).to_have_url(f"{lab_site.url}/account")
        expect(page.get_by_role("heading", name="ada", exact=True)).to_be_visible()
        expect(page.get_by_text("Curator.")).to_be_visible()
        page.get_by_role("button", name="New token").click()
        page.get_by_role("dialog").get_by_label("Name").fill("training cluster")
        page.context.clear_cookies()
        page.get_by_role("dialog").get_by_role("button", name="Create").click()
        asking = page.get_by_role("dialog", name="Your session has ended")
        asking.get_by_role("button", name="I have signed in").click()
        expect(asking.get_by_role("alert")).to_have_text("You are not signed in yet. Sign in first.")
        with page.context.expect_page() as opened:
            asking.get_by_role("link", name="Sign in with Field Robotics Lab").click()
        opened.value.get_by_placeholder("sub").fill("s-ada")
        opened.value.get_by_role("button", name="Authorize").click()
        expect(opened.value.get_by_role("link", name="ada")).to_be_visible()
        asking.get_by_role("button", name="I have signed in").click()
        expect(page.locator("[data-secret]")).to_have_text(re.compile("^stone_"))
        page.reload()
        page.get_by_role("button", name="Sign out", exact=True).click()
        expect(page.get_by_role("banner").get_by_role("link", name="Sign in")).to_be_visible()
        page.goto("/account")
        expect(page.get_by_role("heading", name="Sign in", exact=True)).to_be_visible()


def test_with_passwords_off_the_page_asks_for_none(platform: Platform, oidc_server: OidcServer) -> None:
    with served_lab(platform, oidc_server.settings(**lab_groups()), make_site, passwords=False) as lab:
        page = httpx.get(f"{lab.url}/sign-in").text
        assert 'type="password"' not in page
        assert "Sign in with" in page


def begun(page: Page, **changed: Any) -> dict[str, Any]:
    body = {"name": "stone on laptop", "scopes": ["read", "submit", "upload"], **changed}
    answer = page.request.post("/api/v1/device-grants", data=body)
    assert answer.status == 201, answer.text()
    codes: dict[str, Any] = answer.json()
    return codes


def test_a_program_is_approved_after_signing_in_with_the_provider(lab_site: Site, oidc_server: OidcServer) -> None:
    oidc_server.know("s-ada", preferred_username="ada", groups=["students"])
    with lab_site.visit(expected=["401", *ELSEWHERE]) as page:
        codes = begun(page)
        page.goto(codes["url_with_code"])
        sign_in_at_the_provider(page, "s-ada")
        expect(page.get_by_role("heading", name="Approve this program?")).to_be_visible()
        expect(page.get_by_text(codes["user_code"])).to_be_visible()
        expect(page.get_by_role("heading", name="stone on laptop")).to_be_visible()
        expect(page.get_by_role("listitem").filter(has_text=re.compile("^submit"))).to_be_visible()
        expect(page.get_by_role("listitem").filter(has_text=re.compile("^upload"))).to_have_count(0)
        page.get_by_role("button", name="Approve").click()
        expect(page.get_by_role("heading", name="Approved")).to_be_visible()
        taken = page.request.post("/api/v1/device-grants/token", data={"device_code": codes["device_code"]})
        assert (taken.status, taken.json()["scopes"]) == (201, ["read", "submit"])
