"""Device grants: a person approves a program's code once in a browser, and the code ends with the browser session."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select, update

from services.runtime.access import device_grants, issuing, users
from services.runtime.access.ending import end_all
from services.runtime.access.retention import forget_ended
from services.runtime.access.users import create_user
from services.runtime.orm import AuditEntry, DeviceGrant, Token, User, WebSession
from services.runtime.platform import Platform
from testing.api.lab import served_lab
from testing.api.serving import Person, client_of, in_browser, person

SESSIONS, ME = "/api/v1/sessions", "/api/v1/me"
PASSWORD = "correct horse battery staple"
GRANTS = "/api/v1/device-grants"
ASKED = {"name": "stone on laptop", "scopes": ["read", "submit", "upload", "admin"]}


@pytest.fixture
def uncounted(platform: Platform) -> Iterator[httpx.Client]:
    """Yield a client of an API whose sign-in limit (1,000 a minute) no test reaches."""
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
    """Return the response to a decision that a person makes in a browser."""
    body = {"user_code": code, "approves": approves}
    return uncounted.post(f"{GRANTS}/decision", json=body, headers=in_browser(platform, who))


def taken(uncounted: httpx.Client, device_code: str) -> httpx.Response:
    return uncounted.post(f"{GRANTS}/token", json={"device_code": device_code})


def rested(platform: Platform) -> None:
    """Let the required polling interval of every program pass."""
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
    """The attack: a token valid for a minute approves its own program, which gets a token valid for a year."""
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
    """The attack: the token is fetched after all credentials were ended."""
    root, codes = person(platform, "administrator"), begun(uncounted)
    with platform.database.transaction() as session:
        ada = create_user(session, "ada", "curator", PASSWORD)
    browser = in_browser(platform, Person(ada.id, "ada", ""))
    body = {"user_code": codes["user_code"], "approves": True}
    assert uncounted.post(f"{GRANTS}/decision", json=body, headers=browser).status_code == 204
    user = f"/api/v1/admin/users/{ada.id}"
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
        f"/api/v1/admin/users/{approver.user_id}/credentials/revoke", json={"reason": "stolen"}, headers=root.headers
    )
    assert ended.is_success
    assert uncounted.get(ME, headers=shown).status_code == 401


def test_nothing_is_issued_while_all_credentials_end(platform_on: Platform) -> None:
    """A token fetched while all credentials end is ended too, or never created."""
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
