"""Sign-in by a provider, over HTTP: against a real one, and against one that lies."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from urllib.parse import parse_qs, urlencode, urlsplit

import httpx
import pytest
from sqlalchemy import select

from services.runtime.access import users
from services.runtime.oidc.provider import CALLBACK
from services.runtime.orm import User
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from testing.api.lab import Lab, served_lab
from testing.api.serving import client_of
from testing.servers.forging_provider import ForgingProvider, forging_provider
from testing.servers.oidc import OidcServer, lab_groups

START, ME = "/api/v1/sign-in/oidc", "/api/v1/me"
PASSWORD = "correct horse battery staple"


@contextmanager
def browser(lab: Lab) -> Iterator[httpx.Client]:
    """A client that keeps cookies and follows no redirect by itself."""
    with httpx.Client(base_url=lab.url, timeout=300.0, verify=False, trust_env=False) as client:
        yield client


@pytest.fixture
def lab(platform: Platform, oidc_server: OidcServer) -> Iterator[Lab]:
    with served_lab(platform, oidc_server.settings(**lab_groups())) as made:
        yield made


@pytest.fixture
def forger() -> Iterator[ForgingProvider]:
    with forging_provider() as provider:
        yield provider


@pytest.fixture
def forged(platform: Platform, forger: ForgingProvider) -> Iterator[Lab]:
    with served_lab(platform, forger.settings()) as made:
        yield made


def signed_in(client: httpx.Client, server: OidcServer, subject: str, back: str = "/") -> httpx.Response:
    """The last answer of a sign-in as `subject`: what the callback said."""
    begun = client.get(START, params={"back": back})
    assert begun.status_code == 302, begun.text
    return client.get(server.approve(begun.headers["location"], subject))


def answered(client: httpx.Client, forger: ForgingProvider, **changed: str) -> httpx.Response:
    """What the callback says to the answer of the provider that lies."""
    begun = client.get(START)
    return client.get(f"{CALLBACK}?{urlencode(forger.approve(begun.headers['location']) | changed)}")


def test_somebody_signs_in_with_the_provider_and_comes_back_to_where_they_were(
    lab: Lab, oidc_server: OidcServer
) -> None:
    oidc_server.know("s-ada", preferred_username="ada", groups=["field-team"])
    with browser(lab) as client:
        answer = signed_in(client, oidc_server, "s-ada", "/sequences?list=mine")
        assert (answer.status_code, answer.headers["location"]) == (303, "/sequences?list=mine")
        me = client.get(ME).json()
        assert (me["name"], me["role"], me["is_session"]) == ("ada", "curator", True)
        assert client.cookies.get("stone_sign_in") is None
        signed_out = client.delete("/api/v1/sessions/current", headers={"X-CSRF-Token": me["csrf_token"]})
        assert signed_out.status_code == 204
        assert client.get(ME).status_code == 401


def test_the_cookies_are_for_the_server_alone(lab: Lab, oidc_server: OidcServer) -> None:
    oidc_server.know("s-cookie", preferred_username="cookie", groups=["students"])
    with browser(lab) as client:
        begun = client.get(START)
        kept = begun.headers["set-cookie"]
        assert {"HttpOnly", "SameSite=lax", "Path=/api/v1/sign-in", "Max-Age=600"} <= set(kept.split("; "))
        assert begun.headers["cache-control"] == "no-store"
        answer = client.get(oidc_server.approve(begun.headers["location"], "s-cookie"))
        session = next(one for one in answer.headers.get_list("set-cookie") if one.startswith("stone_session="))
        assert {"HttpOnly", "SameSite=lax", "Path=/"} <= set(session.split("; "))


def test_where_the_platform_is_reached_by_https_the_cookie_is_for_that_alone(
    platform: Platform, oidc_server: OidcServer
) -> None:
    secure = {"oidc": oidc_server.settings(), "api": ApiSettings(url="https://stone.lab.example")}
    with client_of(replace(platform, settings=platform.settings.model_copy(update=secure))) as client:
        begun = client.get(START, headers={"X-Forwarded-Proto": "https"})
        assert "; Secure" in begun.headers["set-cookie"]
        assert "redirect_uri=https%3A%2F%2Fstone.lab.example%2Fapi" in begun.headers["location"]


def test_nobody_is_sent_to_another_host_nor_back_into_the_sign_in(lab: Lab, oidc_server: OidcServer) -> None:
    for back in ["//evil.example/", "/\\evil.example", "https://evil.example/", "/a\tb", "evil", CALLBACK]:
        oidc_server.know("s-back", preferred_username="back", groups=["students"])
        with browser(lab) as client:
            assert signed_in(client, oidc_server, "s-back", back).headers["location"] == "/"


def test_a_page_that_somebody_wrote_into_the_cookie_is_looked_at_again(lab: Lab, oidc_server: OidcServer) -> None:
    oidc_server.know("s-tossed", preferred_username="tossed", groups=["students"])
    with browser(lab) as client:
        begun = client.get(START)
        secret = client.cookies["stone_sign_in"].split(".")[0]
        forged = {"Cookie": f"stone_sign_in={secret}.Ly9ldmlsLmV4YW1wbGUv"}  # //evil.example/
        client.cookies.clear()
        answer = client.get(oidc_server.approve(begun.headers["location"], "s-tossed"), headers=forged)
        assert (answer.status_code, answer.headers["location"]) == (303, "/")


def test_who_is_in_no_group_or_shut_out_is_told_so_and_has_no_session(lab: Lab, oidc_server: OidcServer) -> None:
    oidc_server.know("s-out", preferred_username="out", groups=["strangers"])
    with browser(lab) as client:
        assert signed_in(client, oidc_server, "s-out").json()["code"] == "not_admitted"
        oidc_server.know("s-out", preferred_username="out", groups=["students"])
        assert signed_in(client, oidc_server, "s-out").status_code == 303
    with lab.platform.database.transaction() as session:
        user = session.scalars(select(User).where(User.name == "out")).one()
        users.change_user(session, user, None, is_active=False)
    with browser(lab) as client:
        answer = signed_in(client, oidc_server, "s-out")
        assert (answer.status_code, answer.json()["code"]) == (403, "account_deactivated")
        assert client.get(ME).status_code == 401


def test_the_same_answer_again_signs_nobody_in(lab: Lab, oidc_server: OidcServer) -> None:
    oidc_server.know("s-again", preferred_username="again", groups=["students"])
    with browser(lab) as client:
        begun = client.get(START)
        kept = {"Cookie": f"stone_sign_in={client.cookies['stone_sign_in']}"}
        address = oidc_server.approve(begun.headers["location"], "s-again")
        assert client.get(address).status_code == 303
        client.cookies.clear()
        without, with_cookie = client.get(address), client.get(address, headers=kept)
        assert (without.status_code, without.json()["code"]) == (400, "sign_in_state")
        assert (with_cookie.status_code, with_cookie.json()["code"]) == (403, "provider_refused")
        assert "stone_session" not in client.cookies


def test_somebody_elses_answer_signs_nobody_in(lab: Lab, oidc_server: OidcServer) -> None:
    """Sign-in CSRF: the attacker's answer, brought to the browser of another who began a sign-in too."""
    oidc_server.know("s-mallory", preferred_username="mallory", groups=["students"])
    with browser(lab) as attacker, browser(lab) as victim:
        address = oidc_server.approve(attacker.get(START).headers["location"], "s-mallory")
        victim.get(START)
        answer = victim.get(address)
        assert (answer.status_code, answer.json()["code"]) == (400, "sign_in_state")
        assert victim.get(ME).status_code == 401


def test_who_says_no_at_the_provider_is_not_signed_in(lab: Lab) -> None:
    with browser(lab) as client:
        where = client.get(START).headers["location"]
        denied = httpx.post(where, data={"action": "deny"}, trust_env=False).headers["location"]
        state = parse_qs(urlsplit(where).query)["state"][0]
        answer = client.get(f"{denied}&state={state}" if "state=" not in denied else denied)
        assert (answer.status_code, answer.json()["code"]) == (403, "provider_refused")


def test_a_false_token_is_refused_and_signs_nobody_in(forged: Lab, forger: ForgingProvider) -> None:
    forger.claims = {"nonce": "of another"}
    with browser(forged) as client:
        answer = answered(client, forger)
        assert (answer.status_code, answer.json()["code"]) == (502, "id_token_refused")
        assert client.get(ME).status_code == 401


def test_a_cookie_that_is_none_of_ours_is_no_fault(forged: Lab) -> None:
    for cookie in ["", ".", "x", "x.!!!", "a" * 20_000]:
        with browser(forged) as client:
            answer = client.get(
                CALLBACK, params={"code": "x", "state": "y"}, headers={"Cookie": f"stone_sign_in={cookie}"}
            )
            assert answer.status_code in (400, 431), answer.text


def test_a_provider_that_is_away_or_malformed_is_said_by_a_code(forged: Lab, forger: ForgingProvider) -> None:
    forger.answers["/.well-known/openid-configuration"] = lambda *_: (200, {}, b"<html>")
    with browser(forged) as client:
        assert (client.get(START).status_code, client.get(START).json()["code"]) == (502, "provider_answer")


def test_without_a_provider_there_is_nowhere_to_go(api: httpx.Client) -> None:
    for path in (START, CALLBACK):
        answer = api.get(path)
        assert (answer.status_code, answer.json()["code"]) == (404, "no_provider")
    assert api.get("/api/v1/sign-in").json() == {"passwords": True, "provider": None}


def test_with_passwords_off_nobody_signs_in_by_one(platform: Platform, oidc_server: OidcServer) -> None:
    with platform.database.transaction() as session:
        users.create_user(session, "ada", "curator", PASSWORD)
    with served_lab(platform, oidc_server.settings(**lab_groups()), passwords=False) as lab, browser(lab) as client:
        answer = client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
        assert (answer.status_code, answer.json()["code"]) == (403, "passwords_off")
        ways = client.get("/api/v1/sign-in").json()
        assert ways == {"passwords": False, "provider": {"title": "Field Robotics Lab", "path": START}}
        oidc_server.know("s-boss", preferred_username="boss", groups=["stone-admins"])
        signed_in(client, oidc_server, "s-boss")
        assert client.get(ME).json()["role"] == "administrator"


def test_sign_ins_that_a_stranger_begins_are_counted(platform: Platform, oidc_server: OidcServer) -> None:
    few = {"oidc": oidc_server.settings(), "api": ApiSettings(sign_ins_per_minute=1)}
    with client_of(replace(platform, settings=platform.settings.model_copy(update=few))) as client:
        statuses = [client.get(START).status_code for _ in range(4)]
    assert statuses == [302, 302, 302, 429]
