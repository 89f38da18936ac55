"""Browsers and the programs they help: a cookie that scripts cannot read, and codes that a person approves once."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select, update

from api.middleware.limits import RequestLimits
from services.runtime.access import device_grants, issuing, login_throttle, sessions, users
from services.runtime.access.ending import end_all
from services.runtime.access.retention import forget_ended
from services.runtime.access.users import create_user
from services.runtime.orm import AuditEntry, DeviceGrant, Token, User, WebSession
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from testing.api.lab import served_lab
from testing.api.serving import Person, client_of, in_browser, person

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
        shown = browser.get(SESSIONS).json()
        assert [one["is_current"] for one in shown] == [False, True]
        assert browser.delete(f"{SESSIONS}/others", headers=csrf_of(browser)).status_code == 204
        assert other.get(ME).status_code == 401
    assert [one["is_current"] for one in browser.get(SESSIONS).json()] == [True]


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


GRANTS = "/api/v1/device-grants"
ASKED = {"name": "stone on laptop", "scopes": ["read", "submit", "upload", "admin"]}


@pytest.fixture
def uncounted(platform: Platform) -> Iterator[httpx.Client]:
    """The API, at which nobody is counted."""
    with (
        served_lab(platform, platform.settings.oidc) as lab,
        httpx.Client(base_url=lab.url, timeout=300.0, verify=False, trust_env=False) as client,
    ):
        yield client


@pytest.fixture
def approver(platform: Platform) -> Person:
    return person(platform, "curator", "approver")


def begun(uncounted: httpx.Client, **changed: Any) -> dict[str, Any]:
    answer = uncounted.post(GRANTS, json=ASKED | changed)
    assert answer.status_code == 201, answer.text
    codes: dict[str, Any] = answer.json()
    return codes


def decided(
    uncounted: httpx.Client, platform: Platform, who: Person, code: str, approves: bool = True
) -> httpx.Response:
    """The answer to a decision that somebody makes in a browser."""
    body = {"user_code": code, "approves": approves}
    return uncounted.post(f"{GRANTS}/decision", json=body, headers=in_browser(platform, who))


def taken(uncounted: httpx.Client, device_code: str) -> httpx.Response:
    return uncounted.post(f"{GRANTS}/token", json={"device_code": device_code})


def rested(platform: Platform) -> None:
    """As if every program had waited as long as it was told to."""
    with platform.database.transaction() as session:
        session.execute(update(DeviceGrant).values(polled_ns=0))


def test_a_program_gets_the_token_that_somebody_approved_once(
    uncounted: httpx.Client, platform: Platform, approver: Person
) -> None:
    codes = begun(uncounted)
    assert codes["url_with_code"] == f"{codes['url']}?code={codes['user_code']}"
    pending = taken(uncounted, codes["device_code"])
    assert (pending.status_code, pending.json()["code"]) == (400, "authorization_pending")
    assert decided(uncounted, platform, approver, codes["user_code"].lower().replace("-", " ")).status_code == 204
    token = taken(uncounted, codes["device_code"])
    assert token.status_code == 201
    assert token.headers["cache-control"] == "no-store"
    assert (token.json()["name"], token.json()["scopes"]) == ("stone on laptop", ["read", "submit", "upload"])
    me = uncounted.get("/api/v1/me", headers={"Authorization": f"Bearer {token.json()['secret']}"}).json()
    assert (me["name"], me["is_session"]) == ("approver", False)
    again = taken(uncounted, codes["device_code"])
    assert (again.status_code, again.json()["code"]) == (400, "expired_token")
    with platform.database.reading() as session:
        acts = [one.act for one in session.scalars(select(AuditEntry).order_by(AuditEntry.number))]
        assert acts == ["device.approve", "token.issue"]
        assert session.scalar(select(func.count()).select_from(DeviceGrant)) == 0


def test_a_code_is_decided_upon_once(uncounted: httpx.Client, platform: Platform, approver: Person) -> None:
    codes, eve = begun(uncounted), person(platform, "administrator", "eve")
    assert decided(uncounted, platform, approver, codes["user_code"]).status_code == 204
    assert decided(uncounted, platform, eve, codes["user_code"]).status_code == 404
    token = taken(uncounted, codes["device_code"]).json()
    me = uncounted.get("/api/v1/me", headers={"Authorization": f"Bearer {token['secret']}"}).json()
    assert me["name"] == "approver"


def test_a_token_has_no_more_than_its_approver_holds(uncounted: httpx.Client, platform: Platform) -> None:
    codes, participant = begun(uncounted), person(platform, "participant")
    decided(uncounted, platform, participant, codes["user_code"])
    assert taken(uncounted, codes["device_code"]).json()["scopes"] == ["read", "submit"]


def test_a_token_that_may_not_issue_tokens_may_not_approve(uncounted: httpx.Client, platform: Platform) -> None:
    codes, narrow = begun(uncounted), person(platform, "curator", scopes={"read", "upload", "submit"})
    body = {"user_code": codes["user_code"], "approves": True}
    answer = uncounted.post(f"{GRANTS}/decision", json=body, headers=narrow.headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")


def test_who_asks_too_often_is_told_to_ask_less_often(uncounted: httpx.Client, platform: Platform) -> None:
    codes = begun(uncounted)
    assert taken(uncounted, codes["device_code"]).json()["code"] == "authorization_pending"
    early = taken(uncounted, codes["device_code"])
    assert (early.status_code, early.json()["code"], early.headers["retry-after"]) == (429, "slow_down", "5")
    rested(platform)
    assert taken(uncounted, codes["device_code"]).json()["code"] == "authorization_pending"


def test_a_program_that_was_denied_gets_nothing_ever(
    uncounted: httpx.Client, platform: Platform, approver: Person
) -> None:
    codes = begun(uncounted)
    assert decided(uncounted, platform, approver, codes["user_code"], approves=False).status_code == 204
    denied = taken(uncounted, codes["device_code"])
    assert (denied.status_code, denied.json()["code"]) == (403, "access_denied")
    assert decided(uncounted, platform, approver, codes["user_code"]).status_code == 404
    assert taken(uncounted, codes["device_code"]).json()["code"] == "expired_token"


def test_codes_expire(uncounted: httpx.Client, platform: Platform, approver: Person) -> None:
    approved, waiting = begun(uncounted), begun(uncounted)
    decided(uncounted, platform, approver, approved["user_code"])
    with platform.database.transaction() as session:
        session.execute(update(DeviceGrant).values(expires_ns=1))
    assert taken(uncounted, approved["device_code"]).json()["code"] == "expired_token"
    assert decided(uncounted, platform, approver, waiting["user_code"]).status_code == 404
    assert forget_ended(platform) == 2


def test_who_was_shut_out_after_they_approved_gives_no_token(
    uncounted: httpx.Client, platform: Platform, approver: Person
) -> None:
    codes = begun(uncounted)
    decided(uncounted, platform, approver, codes["user_code"])
    with platform.database.transaction() as session:
        users.change_user(session, session.get_one(User, approver.user_id), None, is_active=False)
    assert taken(uncounted, codes["device_code"]).json()["code"] == "expired_token"


def test_a_role_that_was_lost_after_the_approval_is_not_in_the_token(
    uncounted: httpx.Client, platform: Platform
) -> None:
    boss, codes = person(platform, "administrator", "boss"), begun(uncounted)
    person(platform, "administrator", "other")
    decided(uncounted, platform, boss, codes["user_code"])
    with platform.database.transaction() as session:
        users.change_user(session, session.get_one(User, boss.user_id), "participant", None)
    assert taken(uncounted, codes["device_code"]).json()["scopes"] == ["read", "submit"]


def test_a_device_code_that_nobody_was_given_is_refused(uncounted: httpx.Client) -> None:
    for code in ["x", "x" * 43, "BCDF-GHJK", "stone_" + "x" * 43]:
        begun(uncounted)
        answer = taken(uncounted, code)
        assert (answer.status_code, answer.json()["code"]) == (400, "expired_token")


def test_no_code_is_kept_as_it_is(uncounted: httpx.Client, platform: Platform) -> None:
    codes = begun(uncounted)
    with platform.database.reading() as session:
        row = session.scalars(select(DeviceGrant)).one()
        kept = " ".join(str(value) for value in vars(row).values())
    assert codes["device_code"] not in kept
    assert codes["user_code"].replace("-", "") not in kept


def test_codes_that_are_guessed_are_counted(platform: Platform, approver: Person) -> None:
    with client_of(platform) as uncounted:
        statuses = [decided(uncounted, platform, approver, "BBBB-BBBB").status_code for _ in range(31)]
        begun_ones = [uncounted.post(GRANTS, json=ASKED).status_code for _ in range(31)]
    assert statuses == [404] * 30 + [429]
    assert begun_ones == [201] * 30 + [429]


def test_programs_that_wait_are_bounded(
    uncounted: httpx.Client, platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device_grants, "MOST_WAITING", 1)
    begun(uncounted)
    answer = uncounted.post(GRANTS, json=ASKED)
    assert (answer.status_code, answer.json()["code"]) == (503, "busy")


def test_who_has_too_many_tokens_approves_no_more(
    uncounted: httpx.Client, platform: Platform, approver: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.runtime.access.issuing.MOST_TOKENS", 1)
    assert decided(uncounted, platform, approver, begun(uncounted)["user_code"]).status_code == 409


def test_two_takers_at_once_get_one_token(platform_on: Platform) -> None:
    def take(_: int) -> str:
        with platform_on.database.transaction() as session:
            return device_grants.poll(session, codes.device_code, 60.0).state

    with platform_on.database.transaction() as session:
        approver = users.create_user(session, "approver", "curator")
        codes = device_grants.begin_grant(session, device_grants.DeviceRequest("x", "here", ("read",)))
        grant = device_grants.find_waiting(session, codes.user_code, is_locked=True)
        assert grant is not None
        authority = issuing.authority_for(approver, 60.0)
        issuing.open_session(session, authority)
        device_grants.approve(grant, authority, session.scalars(select(WebSession.id)).one())
    with ThreadPoolExecutor(4) as pool:
        states = list(pool.map(take, range(4)))
    assert sorted(states) == ["approved", "unknown", "unknown", "unknown"]
    with platform_on.database.reading() as session:
        assert issuing.token_count(session, approver.id) == 1
        assert session.scalars(select(Token)).one().name == "x"


def test_a_token_approves_no_program_even_with_the_scope_account(uncounted: httpx.Client, platform: Platform) -> None:
    """The attack: a token of a minute approves its own program, which gets a token of a year."""
    leaked, codes = person(platform, "curator", scopes=["read", "account"], expires_s=60.0), begun(uncounted)
    body = {"user_code": codes["user_code"], "approves": True}
    answer = uncounted.post(f"{GRANTS}/decision", json=body, headers=leaked.headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "browser_only")
    assert "/device" in answer.json()["detail"]
    assert taken(uncounted, codes["device_code"]).json()["code"] == "authorization_pending"
    assert uncounted.post(f"{GRANTS}/decision", json=body | {"approves": False}, headers=leaked.headers).is_success


@pytest.mark.parametrize("end", ["signs out", "all end", "new password", "shut out", "expired"])
def test_an_approved_program_gets_no_token_after_its_approver_ended(
    uncounted: httpx.Client, platform: Platform, end: str
) -> None:
    """The attack: the token is fetched after everything was ended."""
    root, codes = person(platform, "administrator"), begun(uncounted)
    with platform.database.transaction() as session:
        ada = create_user(session, "ada", "curator", PASSWORD)
    browser = in_browser(platform, Person(ada.id, "ada", ""))
    body = {"user_code": codes["user_code"], "approves": True}
    assert uncounted.post(f"{GRANTS}/decision", json=body, headers=browser).status_code == 204
    user = f"/api/v1/users/{ada.id}"
    if end == "signs out":
        answer = uncounted.delete(f"{SESSIONS}/current", headers=browser)
    elif end == "all end":
        answer = uncounted.post(f"{user}/credentials/revoke", json={"reason": "stolen"}, headers=root.headers)
    elif end == "new password":
        passwords = {"current": PASSWORD, "new": PASSWORD + " new"}
        answer = uncounted.put("/api/v1/me/password", json=passwords, headers=browser)
    elif end == "shut out":
        answer = uncounted.patch(user, json={"is_active": False, "reason": "left"}, headers=root.headers)
    else:
        with platform.database.transaction() as session:
            session.execute(update(WebSession).values(expires_ns=1))
    assert end == "expired" or answer.is_success, answer.text
    refused = taken(uncounted, codes["device_code"])
    assert (refused.status_code, refused.json()["code"]) in [(400, "expired_token"), (403, "access_denied")]
    with platform.database.reading() as session:
        assert issuing.token_count(session, ada.id) == 0


def test_a_program_that_was_approved_keeps_its_token_beyond_the_browser(
    uncounted: httpx.Client, platform: Platform, approver: Person
) -> None:
    codes, browser = begun(uncounted), in_browser(platform, approver)
    body = {"user_code": codes["user_code"], "approves": True}
    assert uncounted.post(f"{GRANTS}/decision", json=body, headers=browser).status_code == 204
    token = taken(uncounted, codes["device_code"]).json()
    assert uncounted.delete(f"{SESSIONS}/current", headers=browser).status_code == 204
    shown = {"Authorization": f"Bearer {token['secret']}"}
    assert uncounted.get(ME, headers=shown).status_code == 200
    root = person(platform, "administrator")
    ended = uncounted.post(
        f"/api/v1/users/{approver.user_id}/credentials/revoke", json={"reason": "stolen"}, headers=root.headers
    )
    assert ended.is_success
    assert uncounted.get(ME, headers=shown).status_code == 401


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


def test_a_user_let_in_again_signs_in_anew(uncounted: httpx.Client, platform: Platform) -> None:
    root, ada = person(platform, "administrator"), person(platform, "curator")
    for is_active in (False, True):
        change = {"is_active": is_active, "reason": "left"}
        assert uncounted.patch(f"/api/v1/users/{ada.user_id}", json=change, headers=root.headers).is_success
    assert uncounted.get(ME, headers=ada.headers).status_code == 401


def test_nothing_is_issued_while_all_credentials_end(platform_on: Platform) -> None:
    """A token that is fetched while everything ends is ended too, or never made."""
    for number in range(20):
        with platform_on.database.transaction() as session:
            user = users.create_user(session, f"ada{number}", "curator")
            authority = issuing.authority_for(user, 60.0)
            issuing.open_session(session, authority)
            codes = device_grants.begin_grant(session, device_grants.DeviceRequest("x", "here", ("read",)))
            grant = device_grants.find_waiting(session, codes.user_code)
            assert grant is not None
            own = select(WebSession.id).where(WebSession.user_id == user.id)
            device_grants.approve(grant, authority, session.scalars(own).one())

        def act(turn: int, user_id: str = user.id, code: str = codes.device_code) -> None:
            with platform_on.database.transaction() as session:
                if turn % 2:
                    device_grants.poll(session, code, 60.0)
                else:
                    end_all(session, user_id)

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(act, range(2)))
        with platform_on.database.transaction() as session:
            assert device_grants.poll(session, codes.device_code, 60.0).state == "unknown"
