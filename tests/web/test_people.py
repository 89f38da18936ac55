"""People's pages in a browser: one's own tokens, password and browsers; users and their access, for administrators."""

import re

import httpx
import pytest
from playwright.sync_api import expect

from services.runtime.access import passwords, sessions, tokens, users
from services.runtime.orm import User
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.web.browsing import Site
from tests.web.looking import look

PASSWORD = "correct horse battery staple"


def with_password(platform: Platform, who: Person) -> None:
    hashed = passwords.hash_password(PASSWORD)
    with platform.database.transaction() as session:
        users.change_password(session, session.get_one(User, who.user_id), hashed)


def test_a_token_is_made_shown_once_works_and_is_revoked(site: Site, participant: Person) -> None:
    with site.visit(participant) as page:
        page.goto("/account")
        look(page, "account")
        page.get_by_role("button", name="New token…").click()
        page.get_by_role("dialog").get_by_label("Name").fill("training cluster")
        look(page, "account-new-token")
        page.get_by_role("dialog").get_by_role("button", name="Create").click()
        secret = page.locator("[data-secret]")
        expect(secret).to_have_text(re.compile("^stone_"))
        headers = {"Authorization": f"Bearer {secret.inner_text()}"}
        me = httpx.get(f"{site.url}/api/v1/me", headers=headers)
        assert (me.status_code, me.json()["scopes"]) == (200, ["read"])
        expect(page.get_by_role("heading", name="training cluster", exact=True)).to_be_visible()
        look(page, "account-token")
        page.get_by_role("button", name="Done").click()
        expect(secret).to_be_hidden()
        page.get_by_role("button", name="Revoke training cluster…").click()
        page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
        expect(page.get_by_role("heading", name="training cluster", exact=True)).to_have_count(0)
        assert httpx.get(f"{site.url}/api/v1/me", headers=headers).status_code == 401


def test_the_password_is_changed_and_other_browsers_are_signed_out(site: Site, participant: Person) -> None:
    with_password(site.platform, participant)
    with site.visit(participant) as page:
        with site.platform.database.transaction() as session:
            other = sessions.open_session(session, session.get_one(User, participant.user_id), 3600.0)
        page.goto("/account")
        page.get_by_role("button", name="Sign out other browsers").click()
        expect(page.locator("#browsers li")).to_have_count(1)
        cookie = {"Cookie": f"stone_session={other.secret}"}
        assert httpx.get(f"{site.url}/api/v1/me", headers=cookie).status_code == 401
        page.get_by_label("Current password").fill(PASSWORD)
        page.get_by_label(re.compile("^New password")).fill("another horse, another battery")
        page.get_by_label("Repeat the new password").fill("another horse, another battery")
        page.get_by_role("button", name="Change password").click()
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


def test_a_user_is_added_with_a_password_that_is_shown_once(site: Site, administrator: Person) -> None:
    with site.visit(administrator) as page:
        page.goto("/admin/users")
        page.get_by_role("button", name="Add a user…").click()
        page.get_by_label(re.compile("^Name lowercase")).fill("ada")
        page.get_by_role("radio", name="curator").check()
        page.get_by_role("button", name="Generate").click()
        page.get_by_label("Reason").fill("joins the field team")
        look(page, "users-add")
        page.get_by_role("button", name="Add", exact=True).click()
        secret = page.locator("[data-secret]")
        expect(secret).to_have_text(re.compile("^[a-z2-9]{4}(-[a-z2-9]{4}){4}$"))
        body = {"name": "ada", "password": secret.inner_text()}
        assert httpx.post(f"{site.url}/api/v1/sessions", json=body).json()["role"] == "curator"
        expect(page.get_by_role("link", name="ada", exact=True)).to_be_visible()
        look(page, "users")
        page.get_by_label("Name contains").fill("nobody")
        page.get_by_role("button", name="Filter", exact=True).click()
        expect(page.get_by_role("heading", name="No matching users")).to_be_visible()


def test_a_users_role_access_and_tokens_are_changed_with_reasons(site: Site, administrator: Person) -> None:
    ada = person(site.platform, "curator", "ada")
    with site.platform.database.transaction() as session:
        session.get_one(User, ada.user_id)
        tokens.issue(session, session.get_one(User, ada.user_id), "field laptop", {"read"}, 3600.0)
    with site.visit(administrator) as page:
        page.goto(f"/admin/users/{ada.user_id}")
        page.get_by_role("listitem").filter(has_text="field laptop").get_by_role("button", name="Revoke…").click()
        page.get_by_role("dialog").get_by_label("Reason").fill("it was lost")
        page.get_by_role("dialog").get_by_role("button", name="Revoke…").click()
        expect(page.get_by_role("heading", name="field laptop")).to_have_count(0)
        page.get_by_role("button", name="Change the role…").click()
        page.get_by_role("dialog").get_by_role("radio", name="participant").check()
        page.get_by_role("dialog").get_by_label("Reason").fill("left the field team")
        look(page, "user-role")
        page.get_by_role("dialog").get_by_role("button", name="Change the role…").click()
        expect(page.locator("h1 + .row .tag")).to_have_text("participant")
        page.get_by_role("button", name="Reset password…").click()
        page.get_by_role("textbox", name=re.compile("^Password")).fill(PASSWORD)
        page.get_by_role("dialog").get_by_label("Reason").fill("forgot theirs")
        page.get_by_role("dialog").get_by_role("button", name="Save").click()
        expect(page.locator("[data-secret]")).to_have_text(PASSWORD)
        expect(page.locator("#password")).to_contain_text("Set")
        page.get_by_role("button", name="Deactivate…").click()
        page.get_by_role("dialog").get_by_label("Reason").fill("left")
        page.get_by_role("dialog").get_by_role("button", name="Deactivate…").click()
        expect(page.get_by_text("deactivated", exact=True)).to_be_visible()
        expect(page.get_by_role("button", name="Reactivate…")).to_be_visible()
        expect(page.get_by_text("left the field team").first).to_be_visible()
        look(page, "user")
    assert httpx.get(f"{site.url}/api/v1/me", headers=ada.headers).status_code == 401


@pytest.mark.parametrize("role", ["participant", "curator"])
def test_nobody_else_finds_a_users_page(site: Site, role: str) -> None:
    other = person(site.platform, role)
    with site.visit(other, expected=["403"]) as page:
        answer = page.goto(f"/admin/users/{other.user_id}")
        assert answer is not None
        assert answer.status == 403
