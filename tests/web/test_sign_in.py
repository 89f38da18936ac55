"""Signing in and out at a page, and where the first administrator's password is told to be."""

import logging

import httpx
import pytest
from playwright.sync_api import expect

from services.runtime.access import passwords, users
from services.runtime.embedded.first_start import PASSWORD_FILE, ensure_keys
from services.runtime.orm import User
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from testing.api.serving import Person, serving
from testing.servers.fixtures import Bells, opened
from testing.web.browsing import Site
from tests.web.looking import look
from web.main import make_site

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


@pytest.fixture
def first_password(platform: Platform) -> str:
    """The password of the platform's first start."""
    return ensure_keys(platform).password


@pytest.mark.parametrize("path", ["/sign-in", "/account"])
def test_on_loopback_the_file_of_the_first_password_is_told_and_never_the_password(
    path: str, site: Site, first_password: str
) -> None:
    text = httpx.get(site.url + path, headers={"Accept": "text/html"}).text
    assert str(site.platform.settings.root / PASSWORD_FILE) in text
    assert "<code>admin</code>" in text
    assert first_password
    assert first_password not in text


@pytest.mark.parametrize(
    ("name", "value"), [("Host", "stone.example"), ("Host", "10.0.0.1"), ("X-Forwarded-For", "192.0.2.7")]
)
@pytest.mark.usefixtures("first_password")
def test_a_reader_elsewhere_is_not_told_where_the_first_password_is(name: str, value: str, site: Site) -> None:
    answer = httpx.get(f"{site.url}/sign-in", headers={name: value})
    assert answer.status_code == 200
    assert PASSWORD_FILE not in answer.text


def test_a_platform_that_is_known_by_another_name_does_not_tell_its_files(settings: Settings, bells: Bells) -> None:
    platform = opened(settings.model_copy(update={"api": ApiSettings(url="https://stone.example")}), bells)
    ensure_keys(platform)
    with serving(platform, make_site(platform)) as url:
        assert PASSWORD_FILE not in httpx.get(f"{url}/sign-in").text
    platform.database.close()


def test_without_the_file_nothing_is_told(site: Site) -> None:
    assert PASSWORD_FILE not in httpx.get(f"{site.url}/sign-in").text
