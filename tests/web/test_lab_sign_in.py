"""People of a lab in Chromium: signing in with the lab's provider, and approving a program that signs in."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from services.runtime.platform import Platform
from testing.api.lab import Lab, served_lab
from testing.servers.oidc import OidcServer, lab_groups
from testing.web.browsing import Site
from tests.web.looking import look
from web.main import make_site

ELSEWHERE = ["asked another host: http://127.0.0.1", "cdn.jsdelivr.net", "favicon.ico"]
"""The provider's own page, to which the browser goes, and what that asks for."""


@pytest.fixture
def lab(platform: Platform, oidc_server: OidcServer) -> Iterator[Lab]:
    with served_lab(platform, oidc_server.settings(**lab_groups()), make_site) as made:
        yield made


@pytest.fixture
def site(lab: Lab, browser: Browser) -> Site:
    return Site(lab.url, lab.platform, browser)


def sign_in_at_the_provider(page: Page, subject: str) -> None:
    """From our sign-in page to the provider's form and back."""
    page.get_by_role("link", name="Sign in with Field Robotics Lab").click()
    page.get_by_placeholder("sub").fill(subject)
    page.get_by_role("button", name="Authorize").click()


def test_somebody_signs_in_with_the_provider_comes_back_and_signs_out(site: Site, oidc_server: OidcServer) -> None:
    oidc_server.know("s-ada", preferred_username="Ada", groups=["field-team"])
    with site.visit(expected=["401", *ELSEWHERE]) as page:
        page.goto("/account")
        expect(page.get_by_role("heading", name="Sign in", exact=True)).to_be_visible()
        look(page, "lab-sign-in")
        sign_in_at_the_provider(page, "s-ada")
        expect(page).to_have_url(f"{site.url}/account")
        expect(page.get_by_role("heading", name="ada", exact=True)).to_be_visible()
        expect(page.get_by_text("Curator.")).to_be_visible()
        look(page, "lab-account")
        page.get_by_role("button", name="Sign out").click()
        expect(page.get_by_role("banner").get_by_role("link", name="Sign in")).to_be_visible()
        page.goto("/account")
        expect(page.get_by_role("heading", name="Sign in", exact=True)).to_be_visible()


def test_a_session_that_ends_is_taken_up_again_with_the_provider_in_another_tab(
    site: Site, oidc_server: OidcServer
) -> None:
    oidc_server.know("s-ada", preferred_username="Ada", groups=["field-team"])
    with site.visit(expected=["401", *ELSEWHERE]) as page:
        page.goto("/account")
        sign_in_at_the_provider(page, "s-ada")
        expect(page.get_by_role("heading", name="ada", exact=True)).to_be_visible()
        page.get_by_role("button", name="New token").click()
        page.get_by_role("dialog").get_by_label("Name").fill("training cluster")
        page.context.clear_cookies()
        page.get_by_role("dialog").get_by_role("button", name="Create").click()
        asking = page.get_by_role("dialog", name="Your session has ended")
        asking.get_by_role("button", name="I have signed in").click()
        expect(asking.get_by_role("alert")).to_have_text("You are not signed in yet. Sign in first.")
        look(page, "session-ended-provider")
        with page.context.expect_page() as opened:
            asking.get_by_role("link", name="Sign in with Field Robotics Lab").click()
        opened.value.get_by_placeholder("sub").fill("s-ada")
        opened.value.get_by_role("button", name="Authorize").click()
        expect(opened.value.get_by_role("link", name="ada")).to_be_visible()
        asking.get_by_role("button", name="I have signed in").click()
        expect(page.locator("[data-secret]")).to_have_text(re.compile("^stone_"))


def test_who_is_not_let_in_reads_why(site: Site, oidc_server: OidcServer) -> None:
    oidc_server.know("s-out", preferred_username="out", groups=["strangers"])
    with site.visit(expected=["403", *ELSEWHERE]) as page:
        page.goto("/sign-in")
        sign_in_at_the_provider(page, "s-out")
        expect(page.get_by_text("none of your groups")).to_be_visible()
        look(page, "lab-not-admitted")


def test_with_passwords_off_the_page_asks_for_none(
    platform: Platform, browser: Browser, oidc_server: OidcServer
) -> None:
    with served_lab(platform, oidc_server.settings(**lab_groups()), make_site, passwords=False) as lab:
        site = Site(lab.url, lab.platform, browser)
        with site.visit() as page:
            page.goto("/sign-in")
            expect(page.get_by_role("link", name="Sign in with Field Robotics Lab")).to_be_visible()
            expect(page.get_by_label("Password")).to_have_count(0)
            look(page, "lab-sign-in-only")


def begun(page: Page, **changed: Any) -> dict[str, Any]:
    body = {"name": "stone on laptop", "scopes": ["read", "submit", "upload"], **changed}
    answer = page.request.post("/api/v1/device-grants", data=body)
    assert answer.status == 201, answer.text()
    codes: dict[str, Any] = answer.json()
    return codes


def test_a_program_is_approved_after_signing_in_with_the_provider(site: Site, oidc_server: OidcServer) -> None:
    oidc_server.know("s-ada", preferred_username="ada", groups=["students"])
    with site.visit(expected=["401", *ELSEWHERE]) as page:
        codes = begun(page)
        page.goto(codes["url_with_code"])
        sign_in_at_the_provider(page, "s-ada")
        expect(page.get_by_role("heading", name="Approve this program?")).to_be_visible()
        expect(page.get_by_text(codes["user_code"])).to_be_visible()
        expect(page.get_by_role("heading", name="stone on laptop")).to_be_visible()
        expect(page.get_by_role("listitem").filter(has_text=re.compile("^submit"))).to_be_visible()
        expect(page.get_by_role("listitem").filter(has_text=re.compile("^upload"))).to_have_count(0)
        look(page, "device-approval")
        page.get_by_role("button", name="Approve").click()
        expect(page.get_by_role("heading", name="Approved")).to_be_visible()
        look(page, "device-approved")
        taken = page.request.post("/api/v1/device-grants/token", data={"device_code": codes["device_code"]})
        assert (taken.status, taken.json()["scopes"]) == (201, ["read", "submit"])


def test_a_code_is_typed_and_denied(site: Site, oidc_server: OidcServer) -> None:
    oidc_server.know("s-eve", preferred_username="eve", groups=["students"])
    with site.visit(expected=["401", *ELSEWHERE]) as page:
        page.goto("/device")
        sign_in_at_the_provider(page, "s-eve")
        look(page, "device-code")
        page.get_by_label("The code").fill("bcdf ghjk")
        page.get_by_role("button", name="Continue").click()
        expect(page.get_by_role("alert")).to_contain_text("No program is waiting with the code bcdf ghjk")
        codes = begun(page)
        page.get_by_label("The code").fill(codes["user_code"].lower())
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Deny").click()
        expect(page.get_by_role("heading", name="Denied")).to_be_visible()
        taken = page.request.post("/api/v1/device-grants/token", data={"device_code": codes["device_code"]})
        assert taken.json()["code"] == "access_denied"
