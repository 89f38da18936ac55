"""Browsers: signed in by a cookie that scripts cannot read, and signed out."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx
import pytest
from sqlalchemy import select, update

from api.middleware.limits import RequestLimits
from services.runtime.access import login_throttle, sessions
from services.runtime.access.users import create_user
from services.runtime.orm import AuditEntry, User, WebSession
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from testing.api.serving import Person, client_of, person

SESSIONS, ME = "/api/v1/sessions", "/api/v1/me"
PASSWORD = "correct horse battery staple"


@pytest.fixture
def ada(platform: Platform) -> dict[str, str]:
    with platform.database.transaction() as session:
        create_user(session, "ada", "curator", PASSWORD)
    return {"name": "ada", "password": PASSWORD}


@pytest.fixture
def browser(api: httpx.Client, ada: dict[str, str]) -> Iterator[httpx.Client]:
    """A client that has signed in and holds the cookie."""
    answer = api.post(SESSIONS, json=ada)
    assert answer.status_code == 201, answer.text
    return api


def csrf_of(browser: httpx.Client) -> dict[str, str]:
    return {"X-CSRF-Token": browser.get(ME).json()["csrf_token"]}


def test_a_wrong_name_or_password_is_refused_alike(api: httpx.Client, ada: dict[str, str]) -> None:
    for wrong in [{"password": "wrong password"}, {"name": "eve"}, {"password": ""}, {"name": ""}]:
        answer = api.post(SESSIONS, json={**ada, **wrong})
        assert answer.status_code == (422 if wrong.get("password") == "" else 401)
        if answer.status_code == 401:
            assert answer.json()["code"] == "wrong_password"
            assert "set-cookie" not in answer.headers


def test_who_has_no_password_cannot_sign_in(api: httpx.Client, curator: Person) -> None:
    for password in ("x", "stone_", curator.secret):
        assert api.post(SESSIONS, json={"name": curator.name, "password": password}).status_code == 401


@pytest.mark.whole
def test_sign_ins_are_counted_by_address_and_refused_beyond(
    platform: Platform, ada: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "api.main.RequestLimits", lambda settings: RequestLimits(settings, lambda: 0.0)
    )  # no bucket fills meanwhile
    with client_of(platform) as api:
        wrong = {**ada, "password": "wrong"}
        answers = [api.post(SESSIONS, json=wrong).status_code for _ in range(platform.settings.api.sign_ins_per_minute)]
        assert set(answers) == {401}
        refused = api.post(SESSIONS, json=ada)
        assert (refused.status_code, refused.json()["code"]) == (429, "rate_limited")
        assert 1 <= int(refused.headers["retry-after"]) <= 60
        assert api.get("/api/v1/problems").status_code == 200


def test_a_change_by_cookie_without_the_csrf_token_is_403(browser: httpx.Client) -> None:
    for offered in [None, "", "wrong", "é"]:
        headers = {} if offered is None else {"X-CSRF-Token": offered.encode().decode("latin-1")}
        encoded = {name: value.encode("latin-1") for name, value in headers.items()}
        for answer in (
            browser.post("/api/v1/teams", json={"name": "us"}, headers=encoded),
            browser.delete(f"{SESSIONS}/current", headers=encoded),
            browser.put(f"{ME}/password", json={"current": PASSWORD, "new": PASSWORD + "!"}, headers=encoded),
        ):
            assert (answer.status_code, answer.json()["code"]) == (403, "csrf")


def test_another_sessions_csrf_token_does_not_do(browser: httpx.Client, ada: dict[str, str]) -> None:
    first = csrf_of(browser)
    browser.post(SESSIONS, json=ada)
    assert browser.post("/api/v1/teams", json={"name": "us"}, headers=first).status_code == 403
    assert browser.post("/api/v1/teams", json={"name": "us"}, headers=csrf_of(browser)).status_code == 201


def test_a_signed_in_browser_has_its_users_role_and_a_cookie_scripts_cannot_read(
    api: httpx.Client, ada: dict[str, str]
) -> None:
    answer = api.post(SESSIONS, json=ada)
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=lax" in cookie
    assert "path=/" in cookie
    assert "secure" not in cookie, "this platform is reached by http"
    assert answer.headers["cache-control"] == "no-store"
    me = api.get(ME).json()
    assert (me["name"], me["role"], me["is_session"]) == ("ada", "curator", True)
    assert me["scopes"] == ["account", "read", "submit", "upload"]
    assert me["csrf_token"] == answer.json()["csrf_token"]


def test_behind_https_the_cookie_is_secure(platform: Platform, ada: dict[str, str]) -> None:
    secure = platform.settings.model_copy(update={"api": ApiSettings(url="https://stone.example")})
    with client_of(replace(platform, settings=secure)) as api:
        assert "secure" in api.post(SESSIONS, json=ada).headers["set-cookie"].lower()


def test_a_session_signed_out_is_worth_nothing(browser: httpx.Client) -> None:
    kept = browser.cookies["stone_session"]
    answer = browser.delete(f"{SESSIONS}/current", headers=csrf_of(browser))
    assert answer.status_code == 204
    assert 'stone_session=""' in answer.headers["set-cookie"]
    browser.cookies.clear()
    assert browser.get(ME, headers={"Cookie": f"stone_session={kept}"}).status_code == 401


def test_a_token_is_no_session_to_sign_out(api: httpx.Client, curator: Person) -> None:
    answer = api.delete(f"{SESSIONS}/current", headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")


def test_a_password_changes_for_who_knows_it_and_signs_browsers_out(browser: httpx.Client) -> None:
    new = "another horse, another battery"
    csrf = csrf_of(browser)
    wrong = {"current": "wrong password", "new": new}
    assert browser.put(f"{ME}/password", json=wrong, headers=csrf).status_code == 401
    weak = {"current": PASSWORD, "new": "short"}
    refused = browser.put(f"{ME}/password", json=weak, headers=csrf)
    assert (refused.status_code, refused.json()["code"]) == (422, "weak_password")
    right = {"current": PASSWORD, "new": new}
    assert browser.put(f"{ME}/password", json=right, headers=csrf).status_code == 204
    assert browser.get(ME).status_code == 401
    browser.cookies.clear()
    assert browser.post(SESSIONS, json={"name": "ada", "password": PASSWORD}).status_code == 401
    assert browser.post(SESSIONS, json={"name": "ada", "password": new}).status_code == 201


def test_a_password_changed_while_it_is_checked_opens_nothing(
    api: httpx.Client, platform: Platform, ada: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(user: Any, password: str) -> bool:
        with platform.database.transaction() as session:
            session.execute(update(User).values(password_hash="another"))
        return True

    monkeypatch.setattr(sessions, "is_password_of", slow)
    assert api.post(SESSIONS, json=ada).status_code == 401


def test_the_browsers_one_is_signed_in_with_are_listed_and_the_others_signed_out(
    browser: httpx.Client, platform: Platform, ada: dict[str, str]
) -> None:
    with client_of(platform) as other:
        assert other.post(SESSIONS, json=ada).status_code == 201
        shown = browser.get(SESSIONS).json()["items"]
        assert [one["is_current"] for one in shown] == [False, True]
        assert browser.delete(f"{SESSIONS}/others", headers=csrf_of(browser)).status_code == 204
        assert other.get(ME).status_code == 401
    assert [one["is_current"] for one in browser.get(SESSIONS).json()["items"]] == [True]


def test_a_token_signs_every_browser_of_its_own_user_out(
    browser: httpx.Client, platform: Platform, curator: Person
) -> None:
    with client_of(platform, curator) as api:
        assert api.delete(f"{SESSIONS}/others").status_code == 204
    assert browser.get(ME).status_code == 200, "another user's browser stays"


def test_wrong_passwords_make_the_next_wait_whoever_asks_and_from_any_process(
    platform: Platform, ada: dict[str, str], browser: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(login_throttle, "pause_s", lambda kind, failures: 600 * (kind == "name" and failures >= 2))
    monkeypatch.setattr("api.routes.sessions.address_of", lambda _: "address 10.9.9.9")  # where nobody signed in
    wrong = {**ada, "password": "wrong password"}
    assert [browser.post(SESSIONS, json=wrong).status_code for _ in range(2)] == [401, 401]
    with client_of(platform) as other:
        refused = other.post(SESSIONS, json=ada)
    assert (refused.status_code, refused.json()["code"]) == (429, "guessed_too_often")
    assert 500 < int(refused.headers["retry-after"]) <= 600
    assert browser.get(ME).status_code == 200, "who is in stays in"


@pytest.mark.whole
def test_others_wrong_passwords_shut_nobody_out_where_they_signed_in_before(
    platform: Platform, ada: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ada's own place is 10.0.0.1; a crowd elsewhere fills every count of her name, in the database and in memory."""
    monkeypatch.setattr("api.main.RequestLimits", lambda settings: RequestLimits(settings, lambda: 0.0))
    place = ["10.0.0.1"]
    for module in ("api.routes.sessions", "api.middleware.limits"):
        monkeypatch.setattr(f"{module}.address_of", lambda _: f"address {place[0]}")
    wrong = {**ada, "password": "wrong password"}
    with client_of(platform) as api:
        assert api.post(SESSIONS, json=ada).status_code == 201
        codes = []
        for number in range(40):
            place[0] = f"10.1.0.{number}"
            codes.append(api.post(SESSIONS, json=wrong).json()["code"])
        assert set(codes) == {"wrong_password", "guessed_too_often", "rate_limited"}
        assert api.post(SESSIONS, json=ada).status_code == 429, "where she never was she waits as they do"
        place[0] = "10.0.0.1"
        assert api.post(SESSIONS, json=ada).status_code == 201


def test_a_browser_that_nobody_uses_is_signed_out(platform: Platform, browser: httpx.Client) -> None:
    assert browser.get(ME).status_code == 200
    with platform.database.transaction() as session:
        session.execute(update(WebSession).values(used_ns=WebSession.used_ns - 1801 * 10**9))
    assert browser.get(ME).status_code == 401


def test_signing_out_is_in_the_audit_log(platform: Platform, browser: httpx.Client) -> None:
    browser.delete(f"{SESSIONS}/current", headers=csrf_of(browser))
    with platform.database.reading() as session:
        acts = list(session.scalars(select(AuditEntry.act).order_by(AuditEntry.number)))
    assert acts == ["session.open", "session.close"]


def test_a_form_of_a_strangers_page_signs_nobody_in(api: httpx.Client, ada: dict[str, str]) -> None:
    """Such a form may send text/plain without asking us first; it would sign its visitor in as its author."""
    answer = api.post(SESSIONS, content=json.dumps(ada), headers={"Content-Type": "text/plain"})
    assert answer.status_code == 415
    assert "set-cookie" not in answer.headers


@pytest.mark.parametrize("ends_tokens", [False, True])
def test_a_new_password_ends_tokens_if_its_user_chooses(
    browser: httpx.Client, platform: Platform, ends_tokens: bool
) -> None:
    csrf = csrf_of(browser)
    secret = browser.post("/api/v1/tokens", json={"name": "laptop"}, headers=csrf).json()["secret"]
    change = {"current": PASSWORD, "new": PASSWORD + " new", "ends_tokens": ends_tokens}
    assert browser.put("/api/v1/me/password", json=change, headers=csrf).status_code == 204
    shown = {"Authorization": f"Bearer {secret}"}
    assert browser.get(ME, headers=shown).status_code == (401 if ends_tokens else 200)
    assert browser.get(ME).status_code == 401


def test_a_user_let_in_again_signs_in_anew(api: httpx.Client, platform: Platform) -> None:
    root, ada = person(platform, "administrator"), person(platform, "curator")
    for is_active in (False, True):
        change = {"is_active": is_active, "reason": "left"}
        assert api.patch(f"/api/v1/admin/users/{ada.user_id}", json=change, headers=root.headers).is_success
    assert api.get(ME, headers=ada.headers).status_code == 401
