"""Signing in and out at a page."""

import logging

import pytest
from playwright.sync_api import expect

from services.runtime.access import passwords, users
from services.runtime.orm import User
from testing.api.serving import Person
from testing.web.browsing import Site
from tests.web.looking import look

PASSWORD = "correct horse battery staple"


@pytest.fixture
def somebody(site: Site, curator: Person) -> Person:
    hashed = passwords.hash_password(PASSWORD)
    with site.platform.database.transaction() as session:
        users.change_password(session, session.get_one(User, curator.user_id), hashed)
    return curator


def test_somebody_signs_in_comes_back_to_where_they_were_and_signs_out(site: Site, somebody: Person) -> None:
    with site.visit(expected=["401"]) as page:
        page.goto("/account")
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        look(page, "sign-in")
        page.get_by_label("Name").fill(somebody.name)
        page.get_by_label("Password").fill("a wrong one")
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_role("alert")).to_contain_text("password")
        page.get_by_label("Password").fill(PASSWORD)
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name=somebody.name)).to_be_visible()
        look(page, "account")
        page.get_by_role("button", name="Sign out").click()
        expect(page.get_by_role("banner").get_by_role("link", name="Sign in")).to_be_visible()


@pytest.mark.parametrize("back", ["//elsewhere.example/", "/\\elsewhere.example", "https://elsewhere.example/"])
def test_signing_in_never_leads_to_another_host(site: Site, back: str) -> None:
    with site.visit() as page:
        page.goto(f"/sign-in?back={back}")
        assert page.locator("form").get_attribute("data-then") == "goto:/"


def test_what_is_not_there_is_a_page_that_says_what_to_do(site: Site, curator: Person) -> None:
    with site.visit(curator, expected=["404"]) as page:
        answer = page.goto("/nothing-here")
        assert answer is not None
        assert answer.status == 404
        look(page, "problem")


def test_a_fault_of_ours_is_a_page_with_the_requests_id_and_nothing_of_our_insides(
    site: Site, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("web.pages.home.viewer_for", lambda *_: {}["a secret of ours"])
    monkeypatch.setattr("api.problems.log", logging.getLogger("quiet"))
    with site.visit(curator, expected=["500"]) as page:
        answer = page.goto("/")
        assert answer is not None
        assert answer.status == 500
        expect(page.get_by_text("Request ", exact=False).last).to_be_visible()
        assert "secret" not in page.content()
